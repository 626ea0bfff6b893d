"""Fills closed surfaces of triangles with boxes, so that nothing can hide inside; boxes around any surface."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.voxels import edges, merged
from zarm_trajectory.arrays import Array, Indices

CELLS = 32
"""Most cells along the longest side of the surface's bounding box."""
_PAIRS = 1_000_000
"""Most pairs of a triangle and a column of cells; the grid is coarsened until it has no more."""
_SLACK = 1e-6
"""Relative enlargement of a cell, so that no triangle slips between two because of rounding."""


def inside(triangles: Array) -> tuple[Array, Array]:
    """Boxes, by their corners (m, 3), inside the closed, consistently wound surface of `triangles` (n, 3, 3).

    They are merged cells of a grid that no triangle touches and that the surface winds around; so what they leave out
    is nowhere further from the surface than the diagonal of a cell.
    """
    touched, enclosed, place = _cells(triangles, CELLS)
    return place(np.argwhere(enclosed & ~touched))


def around(triangles: Array, most: int, *, solid: bool) -> tuple[Array, Array]:
    """At most `most` boxes, by their corners (m, 3), that contain the surface of `triangles` (n, 3, 3) and, if `solid`,
    its inside.

    They are merged cells of the finest grid for which that many suffice.
    """
    cells = CELLS
    while True:
        touched, enclosed, place = _cells(triangles, cells)
        lower, upper = place(np.argwhere(touched | enclosed if solid else touched))
        if len(lower) <= most or cells == 1:
            return lower, upper
        cells = max(1, cells * 3 // 4)


_Place = Callable[[Indices], tuple[Array, Array]]
"""Maps cells (n, 3) to the boxes into which they are merged, by their corners (m, 3)."""


def _cells(triangles: Array, cells: int) -> tuple[NDArray[np.bool_], NDArray[np.bool_], _Place]:
    """Which cells (x, y, z) of a grid around a surface a triangle touches, and which the surface winds around; and
    their places.
    """
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    while True:
        size = float((high - low).max()) / cells
        scaled = (triangles - low) / size
        first = np.floor(scaled[:, :, :2].min(axis=1) - _SLACK).astype(np.int64)
        count = np.floor(scaled[:, :, :2].max(axis=1) + _SLACK).astype(np.int64) - first + 1
        if cells == 1 or count.prod(axis=1).sum() <= _PAIRS:
            break
        cells //= 2

    def place(chosen: Indices) -> tuple[Array, Array]:
        lower, upper = edges(*merged(chosen), size)
        return lower + size / 2 + low, upper + size / 2 + low

    return *_touched_and_enclosed(scaled, first, count, cells), place


def _touched_and_enclosed(
    corners: Array, first: Indices, count: Indices, cells: int
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """The unit cells (x, y, z) of a grid that a triangle touches, and those that the surface winds around; `first` and
    `count` (n, 2) are each triangle's columns.
    """
    pairs = count.prod(axis=1)
    owner = np.repeat(np.arange(len(corners)), pairs)
    number = np.arange(len(owner)) - np.repeat(np.cumsum(pairs) - pairs, pairs)
    column = first[owner] + np.column_stack(np.divmod(number, count[owner, 1]))
    meets = _overlap(corners[:, :, :2], owner, column + 0.5)
    owner, column = owner[meets], column[meets]

    # Heights of the triangles' planes over x and y; steep ones span the whole height of the triangle.
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    steep = np.abs(normal[:, 2]) <= 1e-9 * np.linalg.norm(normal, axis=1)
    slope = -normal[:, :2] / np.where(steep, np.inf, normal[:, 2])[:, None]
    level = corners[:, 0, 2] - np.einsum("ni,ni->n", slope, corners[:, 0, :2])

    def height(at: Array) -> Array:
        return np.asarray(level[owner] + np.einsum("ni,ni->n", slope[owner], at))

    middle = height(column + 0.5)
    reach = np.where(steep[owner], np.inf, np.abs(slope[owner]).sum(axis=1) / 2)
    bottom = np.maximum(middle - reach, corners[owner, :, 2].min(axis=1))
    top = np.minimum(middle + reach, corners[owner, :, 2].max(axis=1))

    grid = (cells + 2, cells + 2, cells + 3)  # with a layer around, where nothing is inside

    def summed(column: Indices, z: Array, weight: Array) -> Array:
        """Weights summed along each column, each from its height on."""
        layer = np.clip(np.floor(z).astype(np.int64) + 1, 0, cells + 2)
        flat = np.ravel_multi_index((column[:, 0] + 1, column[:, 1] + 1, layer), grid)
        return np.cumsum(np.bincount(flat, weight, minlength=int(np.prod(grid))).reshape(grid), axis=2)

    one = np.ones(len(owner))
    touched = summed(column, bottom - _SLACK, one) - summed(column, top + _SLACK + 1, one)
    # A vertical line through each column, placed to rarely meet an edge, passes in and out of the surface.
    line = column + np.array([0.5 + 0.0271828, 0.5 - 0.0314159])
    turns = np.sign(normal[owner, 2]) * _contains(corners[:, :, :2], owner, line)
    winding = summed(column, np.clip(height(line), bottom, top), turns)
    closed = np.abs(winding[:, :, -1:]) < 0.5  # otherwise the line met an edge after all
    shown = (slice(1, -1), slice(1, -1), slice(1, -2))
    return touched[shown] > 0.5, ((np.abs(winding) > 0.5) & closed)[shown]


def _overlap(corners: Array, owner: Indices, center: Array) -> NDArray[np.bool_]:
    """Whether unit squares around `center` (m, 2) meet triangles (n, 3, 2): no edge of the triangle separates them.

    The squares already lie within the triangle's bounding box, so this is the separating axis test for convex polygons.
    """
    meets = np.ones(len(owner), bool)
    for edge in range(3):
        along = corners[:, (edge + 1) % 3] - corners[:, edge]
        normal = np.column_stack([-along[:, 1], along[:, 0]])
        extents = np.einsum("nki,ni->nk", corners, normal)
        half = (0.5 + _SLACK) * np.abs(normal).sum(axis=1)
        at = np.einsum("mi,mi->m", center, normal[owner])
        meets &= (at <= (extents.max(axis=1) + half)[owner]) & (at >= (extents.min(axis=1) - half)[owner])
    return meets


def _contains(corners: Array, owner: Indices, point: Array) -> Array:
    """1.0 where triangles (n, 3, 2) contain points (m, 2), else 0.0."""
    sides = []
    for edge in range(3):
        along, start = corners[:, (edge + 1) % 3] - corners[:, edge], corners[:, edge]
        apart = point - start[owner]
        sides.append(along[owner, 0] * apart[:, 1] - along[owner, 1] * apart[:, 0] > 0.0)
    return np.asarray((sides[0] == sides[1]) & (sides[1] == sides[2]), np.float64)
