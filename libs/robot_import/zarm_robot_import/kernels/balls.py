"""Spheres that provably contain convex shapes."""

from __future__ import annotations

import math

import numpy as np

from zarm_geometry.kernels.compiled import kernel
from zarm_geometry.kernels.convex import core_distance, turned
from zarm_trajectory.arrays import Array


@kernel
def around_shapes(balls: Array, rows: Array, finest: float) -> Array:
    """Enlarge the radii of `balls` (k, 4), x, y, z, radius in m, until their union provably contains the shapes (n,
    17), see `zarm_geometry.packed_shapes`.

    The cube around each shape is subdivided like an octree. A cell needs no further work if the sphere around it is
    outside of the shape or inside one of the balls. At half a side of `finest` (m) a ball grows to enclose it: the one
    that has to grow least from its given radius.
    """
    given, balls = balls, balls.copy()
    stack = np.empty((256, 4))
    for t in range(len(rows)):
        r = rows[t]
        turn = (r[0], r[1], r[2], r[4], r[5], r[6], r[8], r[9], r[10])
        core = (r[12], r[13], r[14], r[15])
        stack[0, 0] = -(r[0] * r[3] + r[4] * r[7] + r[8] * r[11])
        stack[0, 1] = -(r[1] * r[3] + r[5] * r[7] + r[9] * r[11])
        stack[0, 2] = -(r[2] * r[3] + r[6] * r[7] + r[10] * r[11])
        wide = math.hypot(r[12] + r[15], r[13] + r[15])
        stack[0, 3] = math.hypot(wide, r[14]) + r[16]
        size = 1
        while size > 0:
            size -= 1
            x, y, z, half = stack[size, 0], stack[size, 1], stack[size, 2], stack[size, 3]
            reach = half * math.sqrt(3.0)
            px, py, pz = turned(turn, (x, y, z))
            if core_distance((px + r[3], py + r[7], pz + r[11]), core) - r[16] > reach:
                continue
            lack, at, within = np.inf, 0, False
            for j in range(len(balls)):
                dx, dy, dz = x - balls[j, 0], y - balls[j, 1], z - balls[j, 2]
                far = math.sqrt(dx * dx + dy * dy + dz * dz) + reach
                if far <= balls[j, 3]:
                    within = True
                    break
                if far - given[j, 3] < lack:
                    lack, at = far - given[j, 3], j
            if within:
                continue
            if half <= finest or size + 8 > len(stack):
                balls[at, 3] = given[at, 3] + lack + 1e-9
                continue
            for c in range(8):
                stack[size, 0] = x + half * (0.5 if c & 1 else -0.5)
                stack[size, 1] = y + half * (0.5 if c & 2 else -0.5)
                stack[size, 2] = z + half * (0.5 if c & 4 else -0.5)
                stack[size, 3] = half / 2
                size += 1
    return balls
