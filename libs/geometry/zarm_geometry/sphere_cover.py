"""Spheres that cover a convex shape completely: attached objects for the collision kernels."""

from __future__ import annotations

import math

import numpy as np

from zarm_geometry.shapes import Shape
from zarm_trajectory.arrays import Array

Grid = tuple[int, int, int]

MOST_BALLS = 64
"""Most balls for one object, unless it consists of more than half as many shapes."""
STANDS_OUT = 0.005
"""No more balls are added once they protrude from the shape by at most this (m), the default margin."""


def sphere_cover(shape: Shape, most: int = MOST_BALLS) -> Array:
    """Spheres (n, 4), x, y, z and radius (m), in the frame of the shape's pose; n <= `most`.

    Every point of the shape is in one of them. They protrude by at most STANDS_OUT, or if that takes too many by as
    little as a grid of MOST allows: 8 mm for a box of 60 x 60 x 100 mm, 18 mm for one of 300 x 200 x 100 mm, 15 % of
    the length for a can as wide as long.
    """
    balls = _in_a_row(shape, most) if shape.rounding else _in_a_grid(shape, most)
    balls[:, :3] = balls[:, :3] @ shape.pose[:3, :3].T + shape.pose[:3, 3]
    return balls


def _in_a_row(shape: Shape, most: int) -> Array:
    """Balls for a sphere or a capsule: from end to end of its segment, ends included, so that each covers its half of a
    gap.
    """
    length, rounding = 2 * shape.core[2], shape.rounding
    for count in range(1 if length == 0.0 else 2, most + 1):
        radius = float(np.hypot(rounding, length / max(count - 1, 1) / 2))
        if radius - rounding <= STANDS_OUT:
            break
    balls = np.zeros((count, 4))
    balls[:, 2], balls[:, 3] = np.linspace(-length / 2, length / 2, count), radius
    return balls


def _in_a_grid(shape: Shape, most: int) -> Array:
    """Balls for a box or a cylinder: one around each cell of the grid over its bounding box that makes them protrude
    least.
    """
    grids = [
        (x, y, z)
        for x in range(1, most + 1)
        for y in ([x] if shape.disc else range(1, most // x + 1))
        for z in range(1, most // (x * y) + 1)
    ]
    out = _cylinder_stands_out if shape.disc else _box_stands_out
    return _grid(shape, min(grids, key=lambda grid: (max(out(shape, grid), STANDS_OUT), math.prod(grid))))


def _box_stands_out(shape: Shape, grid: Grid) -> float:
    """How far (m) the balls of a grid protrude from the faces of a box."""
    cell = shape.half / grid
    return math.hypot(*cell) - float(cell.min())


def _cylinder_stands_out(shape: Shape, grid: Grid) -> float:
    """How far (m) the balls of a grid protrude from the faces of a cylinder."""
    balls = _grid(shape, grid)
    inside = np.minimum(shape.disc - np.hypot(balls[:, 0], balls[:, 1]), shape.half[2] - np.abs(balls[:, 2]))
    return float((balls[:, 3] - inside).max())


def _grid(shape: Shape, grid: Grid) -> Array:
    """The balls around the cells of a grid with this many along each axis; for a cylinder, only non-empty cells."""
    cell = shape.half / grid
    steps = [size * (2 * np.arange(count) + 1 - count) for size, count in zip(cell, grid, strict=True)]
    centers = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 3)
    if not shape.disc:
        return np.column_stack((centers, np.full(len(centers), np.linalg.norm(cell))))
    # Only the bounding box of the disc's part in a cell counts; it lies between these distances from the axis planes.
    near = np.maximum(np.abs(centers[:, :2]) - cell[:2], 0.0)
    centers, near = (rows[np.hypot(*near.T) < shape.disc] for rows in (centers, near))
    far = np.minimum(np.abs(centers[:, :2]) + cell[:2], np.sqrt(shape.disc**2 - near[:, ::-1] ** 2))
    astride = np.abs(centers[:, :2]) < cell[:2]
    centers[:, :2] = np.where(astride, 0.0, np.sign(centers[:, :2]) * (near + far) / 2)
    across = np.hypot(*np.where(astride, far, (far - near) / 2).T)
    across = np.minimum(across, np.hypot(*centers[:, :2].T) + shape.disc)
    return np.column_stack((centers, np.hypot(across, cell[2])))
