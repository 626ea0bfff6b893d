"""How much of the space outside of a body convex shapes cover, and which points are inside shapes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.kernels.compiled import kernel
from zarm_geometry.kernels.convex import core_distance, turned
from zarm_trajectory.arrays import Array


@kernel
def least_outside(rows: Array, start: Array, points: Array, weights: Array, most: float) -> tuple[int, float]:
    """The shape (of n, 17, see `zarm_geometry.packed_shapes`) with the smallest cost: its `start` (n,) plus the `weights` (m,)
    of the points (m, 3) inside it.

    Returns its index and cost; -1 and `most` if no cost is below `most`.
    """
    best, least = -1, most
    for i in range(len(rows)):
        r = rows[i]
        turn = (r[0], r[1], r[2], r[4], r[5], r[6], r[8], r[9], r[10])
        core = (r[12], r[13], r[14], r[15])
        total = start[i]
        for j in range(len(points)):
            if total >= least:
                break
            x, y, z = turned(turn, (points[j, 0], points[j, 1], points[j, 2]))
            if core_distance((x + r[3], y + r[7], z + r[11]), core) <= r[16]:
                total += weights[j]
        if total < least:
            best, least = i, total
    return best, least


@kernel
def within(points: Array, rows: Array, depth: float) -> NDArray[np.bool_]:
    """Which points (m, 3) are inside any of the shapes (n, 17), or at most `depth` (m) outside of it."""
    found = np.zeros(len(points), np.bool_)
    for i in range(len(rows)):
        r = rows[i]
        turn = (r[0], r[1], r[2], r[4], r[5], r[6], r[8], r[9], r[10])
        core = (r[12], r[13], r[14], r[15])
        for j in range(len(points)):
            if not found[j]:
                x, y, z = turned(turn, (points[j, 0], points[j, 1], points[j, 2]))
                found[j] = core_distance((x + r[3], y + r[7], z + r[11]), core) <= r[16] + depth
    return found
