"""The motion inside the limits that is nearest to a wanted one over a horizon: a quadratic program for each joint."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import daqp
import numpy as np

from zarm_trajectory.arrays import Array
from zarm_trajectory.limits import Limits

INTERVAL = 0.024
"""The jerk is constant over this time (s)."""
MAX_INTERVALS = 40
"""Most intervals that are looked ahead: 1 s."""
_SCALE = 0.001
"""An error of so many rad costs as much in an interval ..."""
_EFFORT = 100.0
"""... as a jerk of so many rad/s^3, so that noise of a policy is not followed."""
_HARD, _SOFT = 0, 8
"""Constraints of DAQP that are always kept, and that are kept as well as possible."""
_SOLVED = 1, 2
"""Its flags for a solution, without and with soft constraints."""


class _Horizon(NamedTuple):
    """What the jerks (N,) of the intervals add to position, velocity and acceleration at their ends (N, N), and the curvature of the cost."""

    times: Array
    position: Array
    velocity: Array
    acceleration: Array
    cost: Array


@lru_cache(maxsize=MAX_INTERVALS)
def _horizon(count: int) -> _Horizon:
    index: Array = np.arange(float(count))
    before = np.maximum(index[:, None] - index, 0.0)
    reached = np.tri(count, dtype=np.float64)
    position: Array = reached * (before**2 / 2 + before / 2 + 1 / 6) * INTERVAL**3
    velocity = reached * (before + 0.5) * INTERVAL**2
    cost: Array = position.T @ position / _SCALE**2 + np.eye(count) / _EFFORT**2
    return _Horizon(
        INTERVAL * (index + 1.0),
        position,
        velocity,
        reached * INTERVAL,
        cost,
    )


def nearest_motion(state: Array, wanted: Array, limits: Limits) -> Array | None:
    """The jerks (N, J), each for one INTERVAL from a `state` (3, J) on, with which the joints come nearest to the positions `wanted` (N, J) at
    the ends of the intervals, inside their limits; None if that is not found.

    The speed stays so far below its limit that the acceleration can still be taken back. (Mayne et al., "Constrained model predictive control", 2000;
    solved by DAQP: Arnstroem et al., "A dual active-set solver for embedded quadratic programming using recursive LDL updates", 2022.)
    """
    count, joints = wanted.shape
    horizon = _horizon(count)
    jerks = np.empty((count, joints))
    for j in range(joints):
        p, v, a = state[:, j]
        jerk, steepest, fastest = limits.jerk[j], limits.acceleration[j], limits.velocity[j]
        # An acceleration a still adds a^2 / 2 jerk to the speed when it is taken back at once, and at most half an interval of it between two ends.
        backing = max(steepest / (2 * jerk), INTERVAL / 2)
        drift = p + horizon.times * (v + horizon.times * a / 2) - wanted[:, j]
        speed = v + a * horizon.times
        most = np.concatenate(
            (np.full(count, jerk), np.full(count, steepest) - a, fastest - speed, fastest - speed - backing * a)
        )
        least = np.concatenate(
            (np.full(count, -jerk), np.full(count, -steepest) - a, -fastest - speed, -fastest - speed - backing * a)
        )
        gains = np.concatenate(
            (horizon.acceleration, horizon.velocity, horizon.velocity + backing * horizon.acceleration)
        )
        slope = horizon.position.T @ drift / _SCALE**2
        for speeds in (_HARD, _SOFT):  # a state on the way out of something may already be faster
            sense = np.repeat(np.array([_HARD, _HARD, speeds, speeds], np.int32), count)
            jerks[:, j], _, flag, _ = daqp.solve(horizon.cost, slope, gains, most, least, sense)
            if flag in _SOLVED:
                break
        else:
            return None
    return jerks
