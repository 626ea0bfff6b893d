"""What the plots tell of a moving robot."""

from __future__ import annotations

import numpy as np
import pytest

from zarm_viewer.plots_panel import RATE, Measured


@pytest.mark.parametrize("rate", [100.0, 30.0])
def test_acceleration_and_jerk_are_told_from_velocities(rate: float) -> None:
    measured = Measured(2)
    for time in np.arange(0.0, 2.0, 1 / rate):
        measured.add(np.array([3.0 * time, 5.0 * time**2 / 2]), time)
    velocity, acceleration, jerk = measured.rates()
    assert velocity == pytest.approx([3.0 * time, 5.0 * time**2 / 2])
    assert acceleration == pytest.approx([3.0, 5.0 * time], abs=5.0 * 2 / RATE)
    assert jerk == pytest.approx([0.0, 5.0], abs=1e-6)
