"""The winding number of a surface around points."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.kernels.compiled import kernel

Array = NDArray[np.float64]


@kernel
def winding(points: Array, triangles: Array) -> Array:
    """The winding numbers (n,) of triangles (m, 3, 3) around points (n, 3): 0 outside of a closed surface.

    Van Oosterom and Strackee, "The solid angle of a plane triangle", 1983.
    """
    found = np.empty(len(points))
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        total = 0.0
        for j in range(len(triangles)):
            ax, ay, az = triangles[j, 0, 0] - x, triangles[j, 0, 1] - y, triangles[j, 0, 2] - z
            bx, by, bz = triangles[j, 1, 0] - x, triangles[j, 1, 1] - y, triangles[j, 1, 2] - z
            cx, cy, cz = triangles[j, 2, 0] - x, triangles[j, 2, 1] - y, triangles[j, 2, 2] - z
            la = math.sqrt(ax * ax + ay * ay + az * az)
            lb = math.sqrt(bx * bx + by * by + bz * bz)
            lc = math.sqrt(cx * cx + cy * cy + cz * cz)
            top = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
            below = la * lb * lc + (ax * bx + ay * by + az * bz) * lc
            below += (bx * cx + by * cy + bz * cz) * la + (cx * ax + cy * ay + cz * az) * lb
            total += math.atan2(top, below)
        found[i] = total / (2 * math.pi)
    return found
