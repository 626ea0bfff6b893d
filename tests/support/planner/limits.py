"""Limits for tests that have no robot."""

from __future__ import annotations

import numpy as np

from zarm_trajectory.arrays import Array
from zarm_trajectory.limits import Limits


def joint_limits(velocity: Array, acceleration: Array, jerk: Array) -> Limits:
    """These limits (J,) in rad/s, rad/s^2, rad/s^3, for joints without position limits."""
    everywhere = np.full(len(velocity), np.inf)
    names = tuple(f"joint_{i}" for i in range(len(velocity)))
    return Limits(names, -everywhere, everywhere, velocity, acceleration, jerk)
