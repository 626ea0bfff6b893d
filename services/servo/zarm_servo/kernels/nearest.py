"""Where on a trajectory a robot is."""

from __future__ import annotations

import math

from zarm_geometry.kernels.compiled import brief
from zarm_trajectory.arrays import Array

_FINENESS = 0.001
"""Interval (s) between the times that are compared."""


@brief
def nearest_time(times: Array, coefficients: Array, position: Array, first: float, last: float) -> float:
    """The time from `first` to `last` (s) at which a trajectory is nearest to `position` (J,), to 1 ms, as
    `TimedTrajectory.nearest`.

    `times` (N,) are those of its samples, `coefficients` (6, N - 1, J) the polynomials between them.
    """
    joints, segments = position.shape[0], times.shape[0] - 1
    found, least, segment = first, math.inf, 0
    count = math.ceil((last - first) / _FINENESS)
    for k in range(count + 1):
        time = min(max(first + k * _FINENESS if k < count else last, times[0]), times[segments])
        while segment < segments - 1 and times[segment + 1] <= time:
            segment += 1
        u = (time - times[segment]) / (times[segment + 1] - times[segment])
        away = 0.0
        for j in range(joints):
            value = coefficients[5, segment, j]
            for power in range(4, -1, -1):
                value = value * u + coefficients[power, segment, j]
            away = max(away, abs(value - position[j]))
        if away < least:
            found, least = time, away
    return found
