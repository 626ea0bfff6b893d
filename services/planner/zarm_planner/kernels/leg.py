"""The quickest of a few paths between two configurations, in one compiled call."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.kernels.arrays import Memory, RobotArrays, Single, WorldArrays
from zarm_geometry.kernels.compiled import inlined, kernel
from zarm_geometry.kernels.vectors import copy
from zarm_planner.kernels.clock import seconds
from zarm_planner.kernels.rrt_connect import connect
from zarm_planner.kernels.shortcut import MOST, shortcut
from zarm_planner.kernels.trees import Trees


@inlined
def seconds_between(a: Single, b: Single, fastest: Single) -> float:
    """Time (s) that the slowest joint needs from `a` to `b` at its greatest speed (dof,)."""
    most = 0.0
    for k in range(a.shape[0]):
        most = max(most, abs(b[k] - a[k]) / fastest[k])
    return most


@kernel
def quickest_of(
    robot: RobotArrays,
    world: WorldArrays,
    memory: Memory,
    trees: Trees,
    limits: Single,
    weight: Single,
    ends: Single,
    fastest: Single,
    seeds: NDArray[np.uint64],
    most: int,
    deadline: NDArray[np.float64],
    spent: NDArray[np.float64],
) -> Single:
    """The quickest (n, dof) of the free paths that `seeds` lead to between `ends` (2, dof), each edge at the speed at which one
    joint is at its `fastest` (dof,); one without rows where a search ended after `most` samples or at the deadline. Nothing
    is quicker than the straight way, so that ends the matter.

    Adds the seconds of search and of shortcuts to `spent` (2,). `limits` and `weight` as for `connect`.
    """
    dof = ends.shape[1]
    goals = ends[1:]
    random, now = np.empty(1, np.uint64), np.empty(2, np.int64)
    best = np.empty((0, dof), np.float32)
    least = np.inf
    for seed in seeds:
        if least <= seconds_between(ends[0], ends[1], fastest):
            break
        began = seconds(now)
        random[0] = seed
        path = connect(robot, world, memory, trees, limits, weight, ends[0], goals, random, most, deadline)
        found = seconds(now)
        spent[0] += found - began
        rows = path.shape[0]
        if rows == 0:
            break
        room = np.empty((rows + MOST, dof), np.float32)
        for i in range(rows):
            copy(path[i], room[i])
        random[0] = seed
        rows = shortcut(robot, world, memory, room, rows, random, deadline)
        spent[1] += seconds(now) - found
        time = 0.0
        for i in range(rows - 1):
            time += seconds_between(room[i], room[i + 1], fastest)
        if time < least:
            best, least = room[:rows], time
    return best
