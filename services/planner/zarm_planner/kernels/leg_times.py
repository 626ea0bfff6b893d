"""How long a leg of a route takes at least."""

from __future__ import annotations

import math

import numpy as np

from zarm_geometry.kernels.compiled import brief, inlined
from zarm_trajectory.arrays import Array


@inlined
def _joint_time(way: float, fastest: float, strongest: float, rests: int) -> float:
    """Least time (s) of one joint for a way (rad), accelerating and braking at those of its two ends that rest."""
    ramp = 0.5 * rests * fastest / strongest
    return math.sqrt(2.0 * rests * way / strongest) if way < ramp * fastest else way / fastest + ramp


@brief
def straight_times(starts: Array, goals: Array, fastest: Array, strongest: Array, rests: int) -> Array:
    """Lower bound (n, m) on the time (s) from each of `starts` (n, dof) to each of `goals` (m, dof), with `rests` of
    the two ends at rest.
    """
    times = np.zeros((starts.shape[0], goals.shape[0]))
    for i in range(starts.shape[0]):
        for k in range(goals.shape[0]):
            for j in range(starts.shape[1]):
                way = abs(goals[k, j] - starts[i, j])
                times[i, k] = max(times[i, k], _joint_time(way, fastest[j], strongest[j], rests))
    return times


@brief
def path_time(path: Array, fastest: Array, strongest: Array, rests: int) -> float:
    """Lower bound (s) on the time along a path (n, dof), with `rests` of its two ends at rest.

    Each edge takes at least its slowest joint at full speed; and all edges together take at least each joint's time
    including acceleration and braking.
    """
    ways, edges, joints = np.zeros(path.shape[1]), 0.0, 0.0
    for i in range(path.shape[0] - 1):
        slowest = 0.0
        for j in range(path.shape[1]):
            way = abs(path[i + 1, j] - path[i, j])
            ways[j] += way
            slowest = max(slowest, way / fastest[j])
        edges += slowest
    for j in range(path.shape[1]):
        joints = max(joints, _joint_time(ways[j], fastest[j], strongest[j], rests))
    return max(edges, joints)
