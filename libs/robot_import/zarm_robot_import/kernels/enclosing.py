"""Boxes, cylinders, capsules and spheres that enclose points."""

from __future__ import annotations

import math

import numpy as np

from zarm_geometry.kernels.compiled import inlined, kernel
from zarm_robot_import.kernels.middles import middles
from zarm_trajectory.arrays import Array

THINNEST = 5e-4
"""Minimum half thickness (m) of a primitive ..."""
SLACK = 5e-6
"""... which then grows by this (m) on all sides, to allow for rounding."""
_ANGLES = 12
_MIN_HALF_LENGTH = 1e-4
"""Minimum half distance (m) between the ends of a capsule."""


@kernel
def oriented(points: Array, axes: Array) -> tuple[Array, Array]:
    """For points (m, 3) and each of the frames `axes` (n, 3, 3): the frame turned about its z so that the points'
    bounding rectangle across z is the smallest of a few angles; and a point (n, 3) on the axis parallel to z through
    the middle of the points.
    """
    boxes, axis = np.empty_like(axes), np.zeros((len(axes), 3))
    flat = np.empty((1, len(points), 2))
    for k in range(len(axes)):
        t = axes[k]
        for i in range(len(points)):
            for c in range(2):
                flat[0, i, c] = points[i, 0] * t[0, c] + points[i, 1] * t[1, c] + points[i, 2] * t[2, c]
        middle = middles(flat)[0]
        least = np.inf
        for step in range(_ANGLES // 2):
            angle = math.pi * step / _ANGLES
            cos, sin = math.cos(angle), math.sin(angle)
            low_u, high_u, low_v, high_v = np.inf, -np.inf, np.inf, -np.inf
            for i in range(len(points)):
                u, v = cos * flat[0, i, 0] + sin * flat[0, i, 1], cos * flat[0, i, 1] - sin * flat[0, i, 0]
                low_u, high_u, low_v, high_v = min(low_u, u), max(high_u, u), min(low_v, v), max(high_v, v)
            size = (high_u - low_u) * (high_v - low_v)
            if size < least:
                least = size
                for r in range(3):
                    boxes[k, r, 0] = cos * t[r, 0] + sin * t[r, 1]
                    boxes[k, r, 1] = cos * t[r, 1] - sin * t[r, 0]
                    boxes[k, r, 2] = t[r, 2]
        for r in range(3):
            axis[k, r] = middle[0] * t[r, 0] + middle[1] * t[r, 1]
    return boxes, axis


@kernel
def around(points: Array, turns: Array, boxes: Array, axis: Array, middle: Array) -> Array:
    """Shapes (3 n + 1, 17), see `zarm_geometry.packed_shapes`, each of which contains all points (m, 3).

    They are n boxes with the frames `boxes` (n, 3, 3), then n cylinders and n capsules along the z of the frames
    `turns` (n, 3, 3) through the points `axis` (n, 3), and a sphere around `middle` (3,).
    """
    count = len(turns)
    rows = np.zeros((3 * count + 1, 17))
    low, high, at = np.empty(3), np.empty(3), np.empty(3)
    for k in range(count):
        t, b = turns[k], boxes[k]
        low[:], high[:] = np.inf, -np.inf
        wide = 0.0
        for i in range(len(points)):
            for c in range(3):
                v = points[i, 0] * b[0, c] + points[i, 1] * b[1, c] + points[i, 2] * b[2, c]
                low[c], high[c] = min(low[c], v), max(high[c], v)
            wide = max(wide, _across(points, i, axis[k], t)[0])
        for c in range(3):
            rows[k, 12 + c] = max((high[c] - low[c]) / 2, THINNEST) + SLACK
        _framed(rows[k], b, b @ ((low + high) / 2))
        radius = max(math.sqrt(wide), THINNEST)
        bottom, top, bottom_dome, top_dome = np.inf, -np.inf, np.inf, -np.inf
        for i in range(len(points)):
            square, z = _across(points, i, axis[k], t)
            dome = math.sqrt(max(radius * radius - square, 0.0))
            bottom, top = min(bottom, z), max(top, z)
            bottom_dome, top_dome = min(bottom_dome, z + dome), max(top_dome, z - dome)
        for kind in (1, 2):
            row = rows[kind * count + k]
            below, above = (bottom, top) if kind == 1 else (bottom_dome, top_dome)
            at[:] = axis[k] + t[:, 2] * ((below + above) / 2)
            _framed(row, t, at)
            # If the domes of both ends overlap, the points fit into less than the shortest capsule.
            row[14] = max((above - below) / 2, THINNEST if kind == 1 else _MIN_HALF_LENGTH) + SLACK
            row[14 + kind] = radius + SLACK
    far = 0.0
    for i in range(len(points)):
        square = 0.0
        for c in range(3):
            square += (points[i, c] - middle[c]) ** 2
        far = max(far, square)
    _framed(rows[3 * count], turns[0], middle)
    rows[3 * count, 16] = math.sqrt(far) + SLACK
    return rows


@inlined
def _across(points: Array, i: int, origin: Array, turn: Array) -> tuple[float, float]:
    """A point's squared distance from the z axis of the frame with axes `turn` (3, 3) at `origin` (3,), and its z
    there.
    """
    x, y, z = points[i, 0] - origin[0], points[i, 1] - origin[1], points[i, 2] - origin[2]
    u = x * turn[0, 0] + y * turn[1, 0] + z * turn[2, 0]
    v = x * turn[0, 1] + y * turn[1, 1] + z * turn[2, 1]
    return u * u + v * v, x * turn[0, 2] + y * turn[1, 2] + z * turn[2, 2]


@kernel
def _framed(row: Array, turn: Array, middle: Array) -> None:
    """Write the frame of a shape with axes `turn` (3, 3) and centre `middle` (3,) into its row."""
    for c in range(3):
        for r in range(3):
            row[4 * c + r] = turn[r, c]
        row[4 * c + 3] = -(turn[0, c] * middle[0] + turn[1, c] * middle[1] + turn[2, c] * middle[2])
