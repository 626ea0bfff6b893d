"""Shortcuts along a path (Geraerts and Overmars, "Creating high-quality paths for motion planning", 2007)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.kernels.arrays import Memory, RobotArrays, Space, WorldArrays, space
from zarm_geometry.kernels.compiled import brief, inlined, kernel
from zarm_geometry.kernels.edge import edge_free
from zarm_geometry.kernels.vectors import apart, between, copy
from zarm_planner.kernels.clock import passed
from zarm_planner.kernels.random import uniform
from zarm_trajectory.arrays import Single

MOST_SHORTCUTS = 200
"""Maximum number of shortcuts tried."""
PATIENCE = 40
"""Shortcutting ends after this many failed attempts in a row; twice as many would make paths 1 % shorter."""
GAIN = 0.005
"""A shortcut that saves less than this fraction of the path is not checked."""
SAME = 1e-6
"""Rows that differ by less than this (rad) differ only by float32 rounding."""


@inlined
def skip_vertices(
    checks: Space, path: Single, count: int, deadline: NDArray[np.float64], now: NDArray[np.int64]
) -> int:
    """Connect each remaining vertex straight to the farthest one possible, in place; returns how many vertices remain."""
    kept, i = 1, 0
    while i < count - 1:
        j = count - 1
        while j > i + 1 and (passed(deadline, now) or not edge_free(checks, path[kept - 1], path[j])):
            j -= 1
        copy(path[j], path[kept])
        kept, i = kept + 1, j
    return kept


@kernel
def shortcut(
    robot: RobotArrays,
    world: WorldArrays,
    memory: Memory,
    path: Single,
    count: int,
    random: NDArray[np.uint64],
    deadline: NDArray[np.float64],
) -> int:
    """Shorten the path in the first `count` rows of `path` (count + MOST, dof) in place; returns its new number of
    rows.
    """
    checks = space(robot, world, memory)
    dof = path.shape[1]
    now = np.empty(2, np.int64)
    a, b = np.empty(dof, np.float32), np.empty(dof, np.float32)
    count = skip_vertices(checks, path, count, deadline, now)
    failed = tried = 0
    while count > 2 and failed < PATIENCE and tried < MOST_SHORTCUTS and not passed(deadline, now):
        tried += 1
        failed += 1
        length = 0.0
        for i in range(count - 1):
            length += apart(path[i], path[i + 1])
        # Two points at lengths `early` and `late` along the path; then the edges i and j that contain them, and the
        # lengths along these.
        early, late = uniform(random) * length, uniform(random) * length
        if early > late:
            early, late = late, early
        saved = late - early
        i, edge_i = 0, apart(path[0], path[1])
        while early > edge_i and i < count - 2:
            early -= edge_i
            late -= edge_i
            i += 1
            edge_i = apart(path[i], path[i + 1])
        j, edge_j = i, edge_i
        while late > edge_j and j < count - 2:
            late -= edge_j
            j += 1
            edge_j = apart(path[j], path[j + 1])
        if i == j:
            continue
        between(path[i], path[i + 1], early / edge_i, a)
        between(path[j], path[j + 1], late / edge_j, b)
        saved -= apart(a, b)
        if saved < GAIN * length or not edge_free(checks, a, b):
            continue
        failed = 0
        moved = i + 2 - j  # a and b replace the vertices between i and j + 1
        if moved > 0:
            for v in range(count - 1, j, -1):
                copy(path[v], path[v + moved])
        else:
            for v in range(j + 1, count):
                copy(path[v], path[v + moved])
        copy(a, path[i + 1])
        copy(b, path[i + 2])
        count += moved
    return skip_vertices(checks, path, count, deadline, now)


@brief
def without_repeats(
    rows: Single,
    start: NDArray[np.float64],
    end: NDArray[np.float64],
    lower: NDArray[np.float64],
    upper: NDArray[np.float64],
) -> NDArray[np.float64]:
    """A path of the kernels in float64 (n, dof), with its exact ends `start` and `end` (dof,). Rows in between are
    clamped to `lower` and `upper` (dof,), and left out if they repeat the row before or `end` up to rounding.
    """
    dof = start.shape[0]
    path = np.empty((max(rows.shape[0], 2), dof))
    for k in range(dof):
        path[0, k] = start[k]
    count = 1
    for i in range(1, rows.shape[0] - 1):
        moved, left = 0.0, 0.0
        for k in range(dof):
            value = min(max(float(rows[i, k]), lower[k]), upper[k])
            path[count, k] = value
            moved, left = max(moved, abs(value - path[count - 1, k])), max(left, abs(value - end[k]))
        if min(moved, left) > SAME:
            count += 1
    differs = False
    for k in range(dof):
        differs = differs or end[k] != path[count - 1, k]
    if differs:
        for k in range(dof):
            path[count, k] = end[k]
        count += 1
    return path[:count]
