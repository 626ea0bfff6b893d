"""Balls that cover a convex shape whole: what the kernels know of an object that the robot carries."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from zarm_planner.shapes import Shape

Array = NDArray[np.float64]

MOST = 64
"""At most so many balls cover one shape."""
STANDS_OUT = 0.005
"""No more balls are taken once they stand out of the shape by no more than this (m): as much as the default margin."""


def cover(shape: Shape) -> Array:
    """Balls (n, 4), x, y, z and radius (m), in the frame that the shape's pose is given in; n <= MOST.

    Every point of the shape is in one of them. They stand out of it by at most STANDS_OUT, or where that takes too many by
    as little as a grid of MOST allows: 8 mm for a box of 60 x 60 x 100 mm, 18 mm for one of 300 x 200 x 100 mm.
    """
    centers, radius = _in_a_row(shape) if shape.rounding else _in_a_grid(shape)
    placed = centers @ shape.pose[:3, :3].T + shape.pose[:3, 3]
    return np.column_stack((placed, np.full(len(placed), radius)))


def _in_a_row(shape: Shape) -> tuple[Array, float]:
    """A sphere or a capsule: from end to end of its segment, ends included, so that each covers its half of a gap."""
    length, rounding = 2 * shape.core[2], shape.rounding
    for count in range(1 if length == 0.0 else 2, MOST + 1):
        radius = float(np.hypot(rounding, length / max(count - 1, 1) / 2))
        if radius - rounding <= STANDS_OUT:
            break
    centers = np.zeros((count, 3))
    centers[:, 2] = np.linspace(-length / 2, length / 2, count)
    return centers, radius


def _in_a_grid(shape: Shape) -> tuple[Array, float]:
    """A box or a cylinder: a ball around each cell of the grid over its bounding box that makes them stand out least."""
    grids = [
        np.array((x, y, z))
        for x in range(1, MOST + 1)
        for y in range(1, MOST // x + 1)
        for z in range(1, MOST // (x * y) + 1)
        if not shape.disc or x == y
    ]
    tried = [(_standing_out(shape, grid), int(grid.prod()), i) for i, grid in enumerate(grids)]
    _, _, chosen = min((max(out, STANDS_OUT), count, i) for out, count, i in tried)
    return _grid(shape, grids[chosen])


def _standing_out(shape: Shape, grid: NDArray[np.intp]) -> float:
    """How far (m) the balls of a grid stand out of the faces of a box or a cylinder."""
    cell = shape.half / grid
    if not shape.disc:
        return float(np.linalg.norm(cell) - cell.min())
    centers, radius = _grid(shape, grid)
    out_of_rim = float(np.hypot(centers[:, 0], centers[:, 1]).max()) - shape.disc
    return radius + max(out_of_rim, -float(cell[2]))


def _grid(shape: Shape, grid: NDArray[np.intp]) -> tuple[Array, float]:
    """Centres (n, 3) and radius of the balls around so many cells along each axis."""
    x, y, z = cell = shape.half / grid
    steps = [size * (2 * np.arange(count) + 1 - count) for size, count in zip(cell, grid, strict=True)]
    centers = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 3)
    if not shape.disc:
        return centers, float(np.linalg.norm(cell))
    nearest = np.maximum(np.abs(centers[:, :2]) - (x, y), 0.0)
    centers = centers[np.hypot(*nearest.T) < shape.disc]
    # To the rim from outside: that is nearer to every point of a convex shape, so the balls cover what they did.
    centers[:, :2] *= np.minimum(1.0, shape.disc / np.maximum(np.hypot(*centers[:, :2].T), 1e-12))[:, None]
    # In a single cell the corners of the square around the disc need no ball.
    return centers, float(np.hypot(min(np.hypot(x, y), shape.disc), z))
