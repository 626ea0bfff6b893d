"""Bounds jerk by a moving average over time, and the acceleration limit that this needs."""

from __future__ import annotations

import math

import numpy as np

from zarm_trajectory.limits import Limits
from zarm_trajectory.quintic import Array

DEVIATION = 1e-3
"""How far (rad) each joint may be off when a via is passed."""
_SHORTEST = 0.1
"""Least time to average over, in samples."""


def averaging_window(strongest: Array, limits: Limits, dt: float) -> float:
    """Seconds over which to average: from full acceleration to the opposite within the jerk limits, and never at once."""
    return max(_SHORTEST * dt, float(np.max(2 * strongest / limits.jerk)))


def gentle_acceleration(limits: Limits, dt: float, deviation: float = DEVIATION) -> Array:
    """The acceleration (dof,) at which averaging takes no joint further than `deviation` off the motion.

    In the middle of a window w the average of a motion differs from it by a w^2 / 24 at most, a being the largest
    acceleration: |x(t + s) - x(t) - v(t) s| <= a s^2 / 2, averaged over s from -w / 2 to w / 2.
    """
    most = 24 * deviation / float(np.max(limits.acceleration))
    share = min(
        1.0, most / (_SHORTEST * dt) ** 2, math.cbrt(most / float(np.max(2 * limits.acceleration / limits.jerk)) ** 2)
    )
    return limits.acceleration * share
