"""The compiled search for where a robot is on its trajectory finds what the trajectory itself finds."""

from __future__ import annotations

import numpy as np
import pytest

from zarm_servo.kernels.nearest import nearest_time
from zarm_trajectory.trajectory import TimedTrajectory


@pytest.mark.parametrize("seed", range(20))
def test_the_compiled_search_finds_what_the_trajectory_finds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.004, 0.3, 12))
    trajectory = TimedTrajectory(times, *rng.normal(size=(3, 12, 6)))
    first = rng.uniform(times[0] - 0.2, times[-1])
    last = first + rng.uniform(0.0, 0.5)
    position = trajectory.at(rng.uniform(first, last))[0] + rng.normal(0.0, 0.01, 6)
    found = nearest_time(trajectory.time, trajectory.coefficients, position, first, last)
    assert found == pytest.approx(trajectory.nearest(position, first, last), abs=1e-9)


def test_of_places_where_the_robot_rests_the_earliest_counts() -> None:
    standing = TimedTrajectory.standing(np.ones(6))
    assert nearest_time(standing.time, standing.coefficients, np.ones(6), 0.2, 0.6) == 0.2
