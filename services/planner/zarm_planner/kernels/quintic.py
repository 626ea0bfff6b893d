"""The quintics of a timed trajectory: how much of the limits they use, and positions along them, between the samples
too.

`zarm_trajectory.quintic` has the same polynomials for arrays of any shape.
"""

from __future__ import annotations

import math

import numpy as np

from zarm_geometry.kernels.compiled import brief, inlined
from zarm_trajectory.arrays import Array

HALVINGS = 24
"""Bisections of an interval that contains an extremum of the velocity. They locate it to 1e-7 of the interval, and so
the peak velocity to much less than rounding.
"""


@inlined
def _highest(way: float, v0: float, a0: float, v1: float, a1: float) -> tuple[float, float, float]:
    """The three highest coefficients on [0, 1], as in `zarm_trajectory.quintic`."""
    return (
        10.0 * way - 6.0 * v0 - 1.5 * a0 - 4.0 * v1 + 0.5 * a1,
        -15.0 * way + 8.0 * v0 + 1.5 * a0 + 7.0 * v1 - a1,
        6.0 * way - 3.0 * v0 - 0.5 * a0 - 3.0 * v1 + 0.5 * a1,
    )


@inlined
def _slope(v0: float, a0: float, c3: float, c4: float, c5: float, u: float) -> float:
    """The first derivative of a quintic at `u`."""
    return v0 + u * (a0 + u * (3.0 * c3 + u * (4.0 * c4 + u * 5.0 * c5)))


@inlined
def _bend(a0: float, c3: float, c4: float, c5: float, u: float) -> float:
    """The second derivative of a quintic at `u`."""
    return a0 + u * (6.0 * c3 + u * (12.0 * c4 + u * 20.0 * c5))


@brief
def peaks(
    time: Array, position: Array, velocity: Array, acceleration: Array, limits: Array
) -> tuple[float, float, float]:
    """The peak velocity, acceleration and jerk, as fractions of `limits` (3, dof), of the quintics through samples at
    `time` (n,), each (n, dof).

    The peaks are exact: each derivative has its extrema at the ends and at the roots of the next derivative. These are
    computed only where the control points of a derivative, between which it lies (Farouki and Rajan 1987), may exceed
    the peak so far. NaN if any sample is not finite.
    """
    fastest, strongest, sharpest = 0.0, 0.0, 0.0
    turns = np.empty(4)
    for i in range(time.shape[0] - 1):
        h = time[i + 1] - time[i]
        for j in range(position.shape[1]):
            v0, v1 = velocity[i, j] * h, velocity[i + 1, j] * h
            a0, a1 = acceleration[i, j] * h * h, acceleration[i + 1, j] * h * h
            c3, c4, c5 = _highest(position[i + 1, j] - position[i, j], v0, a0, v1, a1)
            # Jerk is 6 c3 + 24 c4 u + 60 c5 u^2 and has one extremum.
            jerk = max(abs(6.0 * c3), abs(6.0 * c3 + 24.0 * c4 + 60.0 * c5))
            between = abs(6.0 * c3 + 12.0 * c4)
            if not jerk + between < np.inf:  # jerk depends on all six numbers
                return np.nan, np.nan, np.nan
            bend, speed = max(abs(a0), abs(a1)), max(abs(v0), abs(v1))
            bend_bound = max(bend, abs(a0 + 2.0 * c3), abs(a0 + 4.0 * (c3 + c4)))
            bound = max(speed, abs(v0 + 0.25 * a0), abs(v0 + 0.5 * a0 + 0.5 * c3), abs(v1 - 0.25 * a1))
            may_be_fastest = bound > fastest * h * limits[0, j]
            may_be_sharpest = max(jerk, between) > sharpest * h * h * h * limits[2, j]
            if not (may_be_fastest or may_be_sharpest or bend_bound > strongest * h * h * limits[1, j]):
                continue
            turn = -c4 / (5.0 * c5) if c5 != 0.0 else -1.0
            if 0.0 < turn < 1.0:
                jerk = max(jerk, abs(6.0 * c3 + 12.0 * c4 * turn))
            # Acceleration has its extrema where jerk is zero: at most two.
            count, turns[0] = 1, 0.0
            root = 144.0 * c4 * c4 - 360.0 * c3 * c5
            if root >= 0.0:
                half = -12.0 * c4 - math.copysign(math.sqrt(root), c4)
                one, other = 6.0 * c3 / half if half != 0.0 else -1.0, half / (60.0 * c5) if c5 != 0.0 else -1.0
                if one > other:
                    one, other = other, one
                if 0.0 < one < 1.0:
                    turns[count] = one
                    count += 1
                if one < other and 0.0 < other < 1.0:
                    turns[count] = other
                    count += 1
            turns[count] = 1.0
            before = a0
            for k in range(1, count + 1):
                after = _bend(a0, c3, c4, c5, turns[k])
                bend = max(bend, abs(after))
                if may_be_fastest and before * after < 0.0:  # velocity has one extremum between
                    low, high = turns[k - 1], turns[k]
                    for _ in range(HALVINGS):
                        middle = 0.5 * (low + high)
                        if _bend(a0, c3, c4, c5, middle) * before > 0.0:
                            low = middle
                        else:
                            high = middle
                    speed = max(speed, abs(_slope(v0, a0, c3, c4, c5, low)))
                before = after
            fastest = max(speed / (h * limits[0, j]), fastest)
            strongest = max(bend / (h * h * limits[1, j]), strongest)
            sharpest = max(jerk / (h * h * h * limits[2, j]), sharpest)
    return fastest, strongest, sharpest


@brief
def followed(
    time: Array, position: Array, velocity: Array, acceleration: Array, reach: Array, most: float
) -> tuple[Array, Array]:
    """Times (k,) and positions (k, dof) along the quintics through samples at `time` (n,), each (n, dof), including the
    samples.

    From one position to the next, no point that moves by at most `reach` (dof,) m per rad of each joint moves further
    than `most` (m). The bound follows from the velocity's control points, whose convex hull contains it (Farouki and
    Rajan 1987).
    """
    samples, dof = position.shape
    coefficients, pieces = np.empty((samples - 1, 6, dof)), np.empty(samples - 1, np.int64)
    total = 1
    for i in range(samples - 1):
        h = time[i + 1] - time[i]
        way = 0.0
        for j in range(dof):
            v0, v1 = velocity[i, j] * h, velocity[i + 1, j] * h
            a0, a1 = acceleration[i, j] * h * h, acceleration[i + 1, j] * h * h
            c3, c4, c5 = _highest(position[i + 1, j] - position[i, j], v0, a0, v1, a1)
            c = coefficients[i]
            c[0, j], c[1, j], c[2, j], c[3, j], c[4, j], c[5, j] = position[i, j], v0, 0.5 * a0, c3, c4, c5
            middle = abs(v0 + 0.5 * a0 + 0.5 * c3)
            way += reach[j] * max(abs(v0), abs(v0 + 0.25 * a0), middle, abs(v1 - 0.25 * a1), abs(v1))
        pieces[i] = max(1, math.ceil(way / most))
        total += pieces[i]
    times, found = np.empty(total), np.empty((total, dof))
    k = 0
    for i in range(samples - 1):
        c = coefficients[i]
        for piece in range(pieces[i]):
            u = piece / pieces[i]
            times[k] = time[i] + u * (time[i + 1] - time[i])
            for j in range(dof):
                found[k, j] = c[0, j] + u * (c[1, j] + u * (c[2, j] + u * (c[3, j] + u * (c[4, j] + u * c[5, j]))))
            k += 1
    times[k] = time[samples - 1]
    found[k] = position[samples - 1]
    return times, found


@brief
def segment_loads(
    time: Array, position: Array, velocity: Array, acceleration: Array, limits: Array, out: Array
) -> None:
    """Write to `out` (n - 1,) bounds of how far each of the quintics through samples at `time` (n,), each (n, dof), uses
    `limits` (3, dof) of velocity, acceleration and jerk, as `sampling.load`: from the control points of the derivatives.
    """
    for i in range(time.shape[0] - 1):
        h = time[i + 1] - time[i]
        most = 0.0
        for j in range(position.shape[1]):
            v0, v1 = velocity[i, j] * h, velocity[i + 1, j] * h
            a0, a1 = acceleration[i, j] * h * h, acceleration[i + 1, j] * h * h
            c3, c4, c5 = _highest(position[i + 1, j] - position[i, j], v0, a0, v1, a1)
            jerk = max(abs(6.0 * c3), abs(6.0 * c3 + 24.0 * c4 + 60.0 * c5), abs(6.0 * c3 + 12.0 * c4))
            bend = max(abs(a0), abs(a1), abs(a0 + 2.0 * c3), abs(a0 + 4.0 * (c3 + c4)))
            speed = max(abs(v0), abs(v1), abs(v0 + 0.25 * a0), abs(v0 + 0.5 * a0 + 0.5 * c3), abs(v1 - 0.25 * a1))
            most = max(
                most,
                speed / (h * limits[0, j]),
                math.sqrt(bend / (h * h * limits[1, j])),
                (jerk / (h * h * h * limits[2, j])) ** (1.0 / 3.0),
            )
        out[i] = most
