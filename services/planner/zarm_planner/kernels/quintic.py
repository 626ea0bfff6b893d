"""Quintic polynomials between the samples of a motion: what they pass through, and how they use the limits."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.kernels.compiled import brief, inlined

Array = NDArray[np.float64]

CHECKS = 8
"""Moments per interval between samples at which velocity and acceleration are checked."""


class Samples(NamedTuple):
    """A motion: `time` (n,) in s, the rest (n, dof) in rad, rad/s, rad/s^2."""

    time: Array
    position: Array
    velocity: Array
    acceleration: Array


@inlined
def _coefficients(motion: Samples, i: int, joint: int, h: float) -> tuple[float, float, float, float, float, float]:
    """From sample `i` to the next, `h` s later, as x goes from 0 to 1.

    The start fixes three of them; the end gives three equations for the others.
    """
    position, velocity, acceleration = motion.position, motion.velocity, motion.acceleration
    p0, v0, a0 = position[i, joint], velocity[i, joint] * h, acceleration[i, joint] * h * h
    p1, v1, a1 = position[i + 1, joint], velocity[i + 1, joint] * h, acceleration[i + 1, joint] * h * h
    p, v, a = p1 - p0 - v0 - a0 / 2, v1 - v0 - a0, a1 - a0
    return p0, v0, a0 / 2, 10 * p - 4 * v + a / 2, -15 * p + 7 * v - a, 6 * p - 3 * v + a / 2


@brief
def sample(motion: Samples, t: Array, out: Array) -> None:
    """Position, velocity and acceleration `out` (3, k, dof) at times `t` (k,) within the motion."""
    time = motion.time
    for m in range(t.shape[0]):
        low, high = 0, time.shape[0] - 1
        while high - low > 1:
            middle = (low + high) // 2
            if time[middle] <= t[m]:
                low = middle
            else:
                high = middle
        h = time[low + 1] - time[low]
        x = (t[m] - time[low]) / h
        for joint in range(motion.position.shape[1]):
            c0, c1, c2, c3, c4, c5 = _coefficients(motion, low, joint, h)
            out[0, m, joint] = c0 + x * (c1 + x * (c2 + x * (c3 + x * (c4 + x * c5))))
            out[1, m, joint] = (c1 + x * (2 * c2 + x * (3 * c3 + x * (4 * c4 + x * 5 * c5)))) / h
            out[2, m, joint] = (2 * c2 + x * (6 * c3 + x * (12 * c4 + x * 20 * c5))) / (h * h)


@brief
def travel(motion: Samples, reach: Array, out: Array) -> None:
    """How far (n - 1,) a point moves at most per interval, if it moves by `reach` (dof,) at most per rad of each joint.

    A polynomial stays within its Bernstein coefficients (Farouki, "The Bernstein polynomial basis: a centennial
    retrospective", 2012); here these are of the velocity, a quartic. For a part of an interval it is that part of `out`.
    """
    for i in range(motion.time.shape[0] - 1):
        h = motion.time[i + 1] - motion.time[i]
        total = 0.0
        for joint in range(motion.position.shape[1]):
            _, v0, c2, c3, c4, _ = _coefficients(motion, i, joint, h)
            v1 = v0 + c2 / 2
            v2 = v0 + c2 + c3 / 2
            v3 = v0 + 3 * c2 / 2 + 3 * c3 / 2 + c4
            v4 = motion.velocity[i + 1, joint] * h
            total += reach[joint] * max(abs(v0), abs(v1), abs(v2), abs(v3), abs(v4))
        out[i] = total


@inlined
def _larger(worst: float, value: float) -> float:
    """The larger one; NaN where one is."""
    return value if value > worst or math.isnan(value) else worst


@brief
def load(motion: Samples, most: tuple[Array, Array, Array]) -> tuple[float, float, float]:
    """The largest parts of the limits `most`, each (dof,), that velocity, acceleration and jerk come to.

    Velocity and acceleration are taken also between samples, jerk as the mean from sample to sample.
    """
    fastest = hardest = jerkiest = 0.0
    time = motion.time
    for i in range(time.shape[0] - 1):
        h = time[i + 1] - time[i]
        for joint in range(motion.position.shape[1]):
            _, c1, c2, c3, c4, c5 = _coefficients(motion, i, joint, h)
            for check in range(CHECKS):
                x = check / CHECKS
                v = abs(c1 + x * (2 * c2 + x * (3 * c3 + x * (4 * c4 + x * 5 * c5)))) / h
                a = abs(2 * c2 + x * (6 * c3 + x * (12 * c4 + x * 20 * c5))) / (h * h)
                fastest = _larger(fastest, v / most[0][joint])
                hardest = _larger(hardest, a / most[1][joint])
            jerk = abs(motion.acceleration[i + 1, joint] - motion.acceleration[i, joint]) / h
            jerkiest = _larger(jerkiest, jerk / most[2][joint])
    return fastest, hardest, jerkiest
