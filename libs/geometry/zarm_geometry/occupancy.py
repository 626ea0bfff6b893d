"""The cells of a regular grid that the scene's objects reach into."""

from __future__ import annotations

import math
from collections.abc import Callable

import fcl
import numpy as np

from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import MAX_CELLS, MAX_INDEX
from zarm_geometry import packed_shapes
from zarm_geometry.shapes import obstacle_shape
from zarm_geometry.voxels import Cells, distinct
from zarm_geometry.world import World
from zarm_trajectory.arrays import Array

_FIRST = 8
"""Initial number of blocks along the longest side of a shape in the search for its cells."""
_HALVES = np.array(list(np.ndindex(2, 2, 2)))


def reached_cells(world: World, resolution: float, check: Callable[[], None]) -> Cells:
    """The sorted cells (n, 3) that the shapes of a world reach into; cell `(i, j, k)` is a cube centred at itself times
    `resolution` (m).

    `check` is called now and then and may raise. Raises InvalidRequest if there are more than MAX_CELLS.
    """
    found = np.empty((0, 3), np.int64)
    fresh: list[Cells] = []
    waiting = 0
    for row in world.rows:
        check()
        fresh.append(_cells(row, resolution, check))
        waiting += len(fresh[-1])
        if waiting > MAX_CELLS:  # neighbours share cells
            found, fresh, waiting = distinct(np.concatenate([found, *fresh])), [], 0
            _check_count(len(found), resolution)
    found = distinct(np.concatenate([found, *fresh]))
    _check_count(len(found), resolution)
    return found


def _cells(row: Array, resolution: float, check: Callable[[], None]) -> Cells:
    """The cells of one shape (17,): blocks of cells close to it are halved along each axis until they are single cells."""
    lower, upper = (corner[0] for corner in packed_shapes.bounds(row[None]))
    if np.abs((lower, upper)).max() > (MAX_INDEX - 1) * resolution:
        raise InvalidRequest(
            f"an object is too far away for cells of {resolution:g} m; use a coarser resolution", field="resolution"
        )
    level = max(0, math.ceil(math.log2(float((upper - lower).max()) / resolution / _FIRST)))
    low, high = (np.floor((corner / resolution + 0.5) / 2**level).astype(np.int64) for corner in (lower, upper))
    blocks = np.argwhere(np.ones(high - low + 1, bool)) + low
    while True:
        check()
        edge = resolution * 2**level
        # Block b holds the cells from b * 2^level on; at level 0 it is the cell b.
        centres = (blocks + 0.5) * edge - 0.5 * resolution
        away = packed_shapes.distances(centres, row[None])[:, 0]
        near = away <= _CORNER * edge
        blocks, away, centres = blocks[near], away[near], centres[near]
        if level == 0:
            break
        _check_count(len(blocks), resolution)
        blocks = (2 * blocks[:, None] + _HALVES).reshape(-1, 3)
        level -= 1
    sure = away <= 0.5 * resolution  # otherwise a corner may or may not reach the shape
    _check_count(int(sure.sum()), resolution)
    shape = obstacle_shape("", row)
    placed = fcl.CollisionObject(shape.geometry, fcl.Transform(shape.pose[:3, :3], shape.pose[:3, 3]))
    cube = fcl.Box(resolution, resolution, resolution)
    for i in np.flatnonzero(~sure).tolist():
        if i % 1000 == 0:
            check()
        sure[i] = fcl.collide(fcl.CollisionObject(cube, fcl.Transform(centres[i])), placed) > 0
    reached: Cells = blocks[sure]
    return reached


_CORNER = math.sqrt(3.0) / 2.0 * (1.0 + 1e-9)
"""Distance of the corner of a cube from its centre, in edge lengths."""


def _check_count(count: int, resolution: float) -> None:
    if count > MAX_CELLS:
        raise InvalidRequest(
            f"the objects reach into more than {MAX_CELLS} cells of {resolution:g} m; use a coarser resolution",
            field="resolution",
        )
