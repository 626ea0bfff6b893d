"""Occupied voxels around points, merged into boxes."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import PointCloud, Voxels
from zarm_geometry.kernels.joining import Codes, joined
from zarm_trajectory.arrays import Array

Cells = NDArray[np.int64]
T = TypeVar("T", int, float)
S = TypeVar("S", np.float64, np.int64)

_BITS = 21
_MIDDLE = 1 << (_BITS - 1)
FARTHEST_CELL = _MIDDLE - 1
"""Largest absolute index of a cell. -_MIDDLE is left out, so that no code but that of a neighbour is one step away."""
MAX_CELL_DISTANCE = 1e3
"""Largest distance (m) of a cell from the origin of its frame."""


def voxels_of(cloud: PointCloud, field: str) -> Voxels:
    """The voxels that contain a cloud's points. Raises InvalidRequest for points that are too far away."""
    points = np.frombuffer(cloud.coordinates()).reshape(-1, 3)
    check_reach(points, f"{field}.points")
    cells = tuple(zip(*occupied(points, cloud.resolution).T.tolist(), strict=True))
    return Voxels.model_construct(  # from the fields of a valid cloud
        kind="voxels",
        name=cloud.name,
        position=cloud.position,
        orientation=cloud.orientation,
        resolution=cloud.resolution,
        cells=cells,
    )


def cells_of(voxels: Voxels) -> Cells:
    """The cells (n, 3) of voxels, in their order."""
    return _rows(voxels.cells, np.int64)


def _rows(triples: Sequence[tuple[T, T, T]], kind: type[S]) -> NDArray[S]:
    """Triples as rows (n, 3), in a third of the time of `np.array`."""
    return np.fromiter(chain.from_iterable(triples), kind, 3 * len(triples)).reshape(-1, 3)


def check_reach(points: Array, field: str) -> None:
    """Refuse points (n, 3) that are unreasonably far away. Raises InvalidRequest."""
    if np.abs(points).max(initial=0.0) > MAX_CELL_DISTANCE:
        at = int(np.argmax(np.any(np.abs(points) > MAX_CELL_DISTANCE, axis=1)))
        raise InvalidRequest(
            f"{field}.{at} is further than {MAX_CELL_DISTANCE:g} m from the origin of its frame; places are in m",
            field=f"{field}.{at}",
        )


def occupied(points: Array, resolution: float) -> Cells:
    """The sorted, distinct cells (m, 3) that contain points (n, 3); cell `(i, j, k)` is centred at itself times
    `resolution`.
    """
    return distinct(np.rint(points / resolution).astype(np.int64))


def distinct(cells: Cells) -> Cells:
    """The distinct cells of (n, 3), sorted by x, then y, then z."""
    return _decoded(_codes(cells))


def merged(cells: Cells) -> tuple[Cells, Cells]:
    """Boxes that cover exactly the cells (n, 3) without overlap: their first and last cells (m, 3).

    Greedy: cells are joined to rows along z, equal adjacent rows to plates, equal plates to boxes.
    """
    first = last = _codes(cells)
    for axis in range(3):
        first, last = joined(first, last, 1 << axis * _BITS)
    return _decoded(first), _decoded(last)


def _codes(cells: Cells) -> Codes:
    """The distinct cells of (n, 3) as ascending codes (m,): x, y and z in _BITS each, z in the lowest."""
    i, j, k = cells.T + _MIDDLE
    codes: Codes = (i << 2 * _BITS) | (j << _BITS) | k
    if not np.all(codes[1:] > codes[:-1]):
        codes.sort()
        codes = codes[np.diff(codes, prepend=-1) != 0]
    return codes


def _decoded(codes: Codes) -> Cells:
    """The cells (n, 3) with these codes (n,)."""
    mask = (1 << _BITS) - 1
    return np.column_stack([codes >> 2 * _BITS, (codes >> _BITS) & mask, codes & mask]) - _MIDDLE


def edges(low: Cells, high: Cells, resolution: float) -> tuple[Array, Array]:
    """Corners (n, 3), in m, of boxes from their first and last cells."""
    return (low.astype(np.float64) - 0.5) * resolution, (high.astype(np.float64) + 0.5) * resolution


def coarse(cells: Cells, resolution: float, most: int) -> tuple[Array, Array]:
    """At most `most` boxes, by their corners (m, 3), that contain cells (n, 3): of the smallest blocks of cells that
    suffice.
    """
    block = 1
    while True:
        low, high = merged(cells // block)
        if len(low) <= most:
            lower: Array = (low.astype(np.float64) * block - 0.5) * resolution
            upper: Array = ((high.astype(np.float64) + 1.0) * block - 0.5) * resolution
            return lower, upper
        block += 1
