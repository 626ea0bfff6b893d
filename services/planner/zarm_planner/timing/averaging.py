"""Bounds jerk by a moving average over time, and computes the acceleration limit that this needs."""

from __future__ import annotations

import math

import numpy as np

from zarm_trajectory.limits import Limits
from zarm_trajectory.quintic import Array

DEVIATION = 1e-3
"""Largest deviation (rad) of each joint when passing a via."""
_SHORTEST = 0.1
"""Least averaging time, in samples."""


def averaging_window(strongest: Array, limits: Limits, dt: float) -> float:
    """The averaging time (s): from full acceleration to the opposite within the jerk limits, and never instantaneous."""
    return max(_SHORTEST * dt, 2 * float((strongest / limits.jerk).max()))


def gentle_acceleration(limits: Limits, dt: float, deviation: float = DEVIATION) -> Array:
    """The acceleration (dof,) at which averaging moves no joint more than `deviation` off the motion.

    In the middle of a window w, the average of a motion differs from it by at most a w^2 / 24, with a the largest
    acceleration: |x(t + s) - x(t) - v(t) s| <= a s^2 / 2, averaged over s from -w / 2 to w / 2.
    """
    most = 24 * deviation / float(np.max(limits.acceleration))
    share = min(
        1.0, most / (_SHORTEST * dt) ** 2, math.cbrt(most / float(np.max(2 * limits.acceleration / limits.jerk)) ** 2)
    )
    return limits.acceleration * share
