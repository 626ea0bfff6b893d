"""The control loop computes with memory that it has: getting it from the system each time takes several times as long."""

from __future__ import annotations

import subprocess
import sys

import pytest

PROGRAM = """
import resource, sys
import numpy as np
from zarm_contract.robot import load_robot
from zarm_executor.service import _give_back_large_blocks
from zarm_trajectory.rate_bounds import RateBounds, RateLimits
from zarm_trajectory.trajectory import TimedTrajectory

_give_back_large_blocks()
descriptor = load_robot(sys.argv[1]).descriptor
limits, time = RateLimits.of(descriptor), np.arange(0.0, 3.0, 0.02)
speeds = np.linspace(1.0, 2.0, len(descriptor.joints))
turns = time[:, None] * speeds
trajectory = TimedTrajectory(time, np.sin(turns), speeds * np.cos(turns), -(speeds**2) * np.sin(turns))

def faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for way in (-1, 1):
        RateBounds(trajectory, limits).at(5, 1.0, way)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

for _ in range(5):
    faults()
print(sorted(faults() for _ in range(20))[10])
"""


@pytest.mark.skipif(sys.platform != "linux", reason="page faults are counted as Linux does")
@pytest.mark.parametrize("robot", ["doosan_m1013", "panda"])
def test_bounds_of_the_path_speed_get_no_memory_from_the_system(robot: str) -> None:
    ended = subprocess.run(
        [sys.executable, "-c", PROGRAM, robot], capture_output=True, text=True, timeout=60, check=True
    )
    assert int(ended.stdout) < 20
