"""Every pose of a calibration is reached, whatever else the machine does; `tests/benchmarks/calibration.py` repeats it."""

from __future__ import annotations

from pathlib import Path

import pytest

from support.ros.calibration import calibrate

BUSY = 4


@pytest.mark.slow
@pytest.mark.parametrize("strategy", ["joint_speed", "joint_trajectory"])
def test_every_calibration_pose_is_reached_on_a_busy_machine(tmp_path: Path, strategy: str) -> None:
    assert not calibrate(tmp_path, strategy, busy=BUSY)
