"""Occupied cells of a regular grid, found around points and merged to boxes."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Cells = NDArray[np.int64]

_BITS = 21
_MIDDLE = 1 << (_BITS - 1)
FARTHEST_CELL = _MIDDLE - 1
"""No index of a cell is further from 0."""


def occupied(points: ArrayLike, resolution: float) -> Cells:
    """The cells (m, 3) that points (n, 3) lie in, each once, in order; cell `(i, j, k)` is centred at itself times `resolution`."""
    return distinct(np.rint(np.asarray(points, np.float64) / resolution).astype(np.int64))


def distinct(cells: Cells) -> Cells:
    """Cells (n, 3), each once, sorted by x, then y, then z."""
    i, j, k = cells.T + _MIDDLE
    codes = np.unique((i << 2 * _BITS) | (j << _BITS) | k)
    mask = (1 << _BITS) - 1
    return np.column_stack([codes >> 2 * _BITS, (codes >> _BITS) & mask, codes & mask]) - _MIDDLE


def merged(cells: Cells) -> tuple[Cells, Cells]:
    """Boxes that cover cells (n, 3) and nothing else, without overlap: their first and last cells (m, 3).

    Greedy: cells are joined to rows along z, equal rows side by side to plates, equal plates to boxes.
    """
    low = high = distinct(cells)
    for axis in (2, 1, 0):
        across = [other for other in range(3) if other != axis]
        ends = np.column_stack([low[:, across], high[:, across]])
        order = np.lexsort((low[:, axis], *ends.T))
        low, high, ends = low[order], high[order], ends[order]
        fresh = np.ones(len(low), bool)
        fresh[1:] = np.any(ends[1:] != ends[:-1], axis=1) | (low[1:, axis] != high[:-1, axis] + 1)
        first = np.flatnonzero(fresh)
        low, high = low[first], high[np.append(first, len(fresh))[1:] - 1]
    return low, high


def edges(low: Cells, high: Cells, resolution: float) -> tuple[Array, Array]:
    """Corners (n, 3), in m, of boxes from their first and last cells."""
    return (low.astype(np.float64) - 0.5) * resolution, (high.astype(np.float64) + 0.5) * resolution
