"""How much of the space outside of a body convex shapes take."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.kernels.compiled import kernel
from zarm_geometry.kernels.convex import core_distance, turned

Array = NDArray[np.float64]


@kernel
def outside(rows: Array, points: Array, weights: Array) -> Array:
    """For each shape (n, 17), see `zarm_geometry.rows`, the sum of the `weights` (m,) of the points (m, 3) in it."""
    found = np.zeros(len(rows))
    for i in range(len(rows)):
        r = rows[i]
        turn = (r[0], r[1], r[2], r[4], r[5], r[6], r[8], r[9], r[10])
        core = (r[12], r[13], r[14], r[15])
        for j in range(len(points)):
            x, y, z = turned(turn, (points[j, 0], points[j, 1], points[j, 2]))
            if core_distance((x + r[3], y + r[7], z + r[11]), core) <= r[16]:
                found[i] += weights[j]
    return found
