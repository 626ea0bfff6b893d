"""The winding number of a surface around points."""

from __future__ import annotations

import math

import numpy as np

from zarm_geometry.kernels.compiled import kernel
from zarm_trajectory.arrays import Array

_BLOCK = 64
"""Points for which the loop over the triangles runs once, so that they are computed several at a time (SIMD)."""
_LANES = 8
"""A smaller number of points is filled up to a multiple of this, which takes less time than points one by one."""


@kernel
def winding(points: Array, triangles: Array) -> Array:
    """The winding numbers (n,) of triangles (m, 3, 3) around points (n, 3): 0 outside of a closed surface.

    Van Oosterom and Strackee, "The solid angle of a plane triangle", 1983. Half the solid angle of a triangle is the angle of a
    complex number. Instead of the angles, the sum takes the product of these numbers, kept near 1, and counts its turns.
    """
    found = np.empty(len(points))
    xs, ys, zs = np.empty(_BLOCK), np.empty(_BLOCK), np.empty(_BLOCK)
    real, imaginary, turns = np.empty(_BLOCK), np.empty(_BLOCK), np.empty(_BLOCK)
    for start in range(0, len(points), _BLOCK):
        count = min(_BLOCK, len(points) - start)
        filled = (count + _LANES - 1) // _LANES * _LANES
        for i in range(filled):
            k = start + min(i, count - 1)
            xs[i], ys[i], zs[i] = points[k, 0], points[k, 1], points[k, 2]
        real[:], imaginary[:], turns[:] = 1.0, 0.0, 0.0
        for j in range(len(triangles)):
            a0, a1, a2 = triangles[j, 0, 0], triangles[j, 0, 1], triangles[j, 0, 2]
            b0, b1, b2 = triangles[j, 1, 0], triangles[j, 1, 1], triangles[j, 1, 2]
            c0, c1, c2 = triangles[j, 2, 0], triangles[j, 2, 1], triangles[j, 2, 2]
            for i in range(filled):
                x, y, z = xs[i], ys[i], zs[i]
                ax, ay, az = a0 - x, a1 - y, a2 - z
                bx, by, bz = b0 - x, b1 - y, b2 - z
                cx, cy, cz = c0 - x, c1 - y, c2 - z
                la = math.sqrt(ax * ax + ay * ay + az * az)
                lb = math.sqrt(bx * bx + by * by + bz * bz)
                lc = math.sqrt(cx * cx + cy * cy + cz * cz)
                top = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
                below = la * lb * lc + (ax * bx + ay * by + az * bz) * lc
                below += (bx * cx + by * cy + bz * cz) * la + (cx * ax + cy * ay + cz * az) * lb
                size = abs(top) + abs(below)
                # At a corner of the triangle there is no angle.
                top, below = (top / size, below / size) if size > 0.0 else (0.0, 1.0)
                was = imaginary[i]
                re, im = real[i] * below - was * top, real[i] * top + was * below
                # Past a half turn: two angles of one sign whose sum has the other.
                turns[i] += 1.0 if (top > 0.0) & (was >= 0.0) & (im < 0.0) else 0.0
                turns[i] -= 1.0 if (top < 0.0) & (was < 0.0) & (im >= 0.0) else 0.0
                size = abs(re) + abs(im)
                real[i], imaginary[i] = re / size, im / size
        for i in range(count):
            found[start + i] = turns[i] + math.atan2(imaginary[i], real[i]) / (2 * math.pi)
    return found
