"""The pace of a motion: how fast it goes through its own time, so that what it needs stays within limits."""

from __future__ import annotations

import math

import numpy as np

from zarm_geometry.kernels.compiled import brief, inlined
from zarm_trajectory.arrays import Array

_NONE = 1e-9
"""What keeps a bound of 0 from dividing by 0."""


@brief
def times_at_pace(time: Array, square: Array) -> Array:
    """When (n,) in s the motion gets to the points of a grid `time` (n,) at the squares (n,) of its pace."""
    at = np.empty_like(time)
    at[0] = 0.0
    for i in range(1, time.shape[0]):
        at[i] = at[i - 1] + 2.0 * (time[i] - time[i - 1]) / (math.sqrt(square[i]) + math.sqrt(square[i - 1]))
    return at


@inlined
def _raw(time: Array, pace: Array, at: Array, i: int, t: float) -> tuple[float, float, float]:
    """The motion's time, the pace and its rate at the time `t` (s), in the interval `i`."""
    rate = (pace[i + 1] - pace[i]) / (at[i + 1] - at[i])
    away = t - at[i]
    return time[i] + away * (pace[i] + 0.5 * rate * away), pace[i] + rate * away, rate


@brief
def averaged_pace(time: Array, square: Array, at: Array, window: float, times: Array) -> Array:
    """The motion's time, the pace, its rate and the rate of that (4, k) at the ascending `times` (k,) in s, each averaged
    over `window` s; the motion gets to the points of a grid `time` (n,) with the squares (n,) of its pace at the times `at` (n,).
    Before and after these the pace stays.
    """
    count = time.shape[0]
    s, pace, reached = np.empty(count + 2), np.empty(count + 2), np.empty(count + 2)
    s[1:-1], pace[1:-1], reached[1:-1] = time, np.sqrt(square), at
    pace[0], pace[-1] = pace[1], pace[-2]
    reached[0], reached[-1] = at[0] - window, at[-1] + window
    s[0], s[-1] = time[0] - window * pace[0], time[-1] + window * pace[-1]
    out = np.empty((4, times.shape[0]))
    before, after = 0, 0
    for k in range(times.shape[0]):
        begin, end = times[k] - 0.5 * window, times[k] + 0.5 * window
        while before < count and reached[before + 1] <= begin:
            before += 1
        while after < count and reached[after + 1] <= end:
            after += 1
        first, slow, slowing = _raw(s, pace, reached, before, begin)
        last, fast, growing = _raw(s, pace, reached, after, end)
        out[1, k], out[2, k], out[3, k] = (last - first) / window, (fast - slow) / window, (growing - slowing) / window
        area, here = 0.0, begin
        for i in range(before, after + 1):
            there = end if i == after else reached[i + 1]
            middle, _, rate = _raw(s, pace, reached, i, 0.5 * (here + there))
            area += (there - here) * (middle + rate * (there - here) ** 2 / 24.0)
            here = there
        out[0, k] = area / window
    return out


@brief
def tightened(
    at: Array, pace: Array, needs: Array, motion: Array, rates: Array, reach: float, share: Array, most: Array
) -> float:
    """Lower the `share` (n,) of their bounds that `needs` may take, and `most` (n,), the largest square of the pace, within
    `reach` s of the points of the grid where the averaged `pace` (4, n), reached at the times `at` (n,), exceeds them or the
    limits `rates` (2, columns) of acceleration and jerk. Returns how far these are used at most, 1 being fully.

    `motion` (3, n, columns) has the velocity, acceleration and jerk at the grid points.
    """
    count = at.shape[0]
    asked, allowed = share.copy(), most.copy()
    worst = 0.0
    for i in range(count):
        ds, dds, ddds = pace[1, i], pace[2, i], pace[3, i]
        square, used = ds * ds, 0.0
        for r in range(needs.shape[2]):
            value = needs[0, i, r] * square + needs[1, i, r] * dds
            used = max(used, value / (needs[3, i, r] + _NONE), value / (needs[2, i, r] - _NONE))
        load = 0.0
        for j in range(motion.shape[2]):
            v, a, jerk = motion[0, i, j], motion[1, i, j], motion[2, i, j]
            load = max(load, math.sqrt(abs(a * square + v * dds) / rates[0, j]))
            load = max(load, (abs(jerk * square * ds + 3.0 * a * ds * dds + v * ddds) / rates[1, j]) ** (1.0 / 3.0))
        worst = max(worst, used, load)
        if used <= 1.0 and load <= 1.0:
            continue
        first, last = i, i
        while first > 0 and at[first - 1] >= at[i] - reach:
            first -= 1
        while last < count - 1 and at[last + 1] <= at[i] + reach:
            last += 1
        for k in range(first, last + 1):
            if used > 1.0:
                share[k] = min(share[k], asked[k] / used)
            if load > 1.0:
                most[k] = min(most[k], min(allowed[k], square) / load**2)
    return worst
