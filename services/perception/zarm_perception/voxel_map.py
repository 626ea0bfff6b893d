"""The voxel map: what cameras have seen of a box around the robot."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from zarm_contract.image import COUNTS, OF_ROBOT, mask_step
from zarm_perception.kernels.integration import (
    BLOCK,
    FREE,
    OCCUPIED,
    UNSEEN,
    Depth,
    Grid,
    Mask,
    View,
    cleaned,
    clear,
    filled,
    least_depths,
    mark,
    mask_robot,
    take_out,
)
from zarm_trajectory.arrays import Array

Cells = NDArray[np.bool_]
BlockIndex = tuple[int, int, int]


class RobotShape(NamedTuple):
    """The robot at some joints, and what else is left out: convex `parts` (m, 17), see `zarm_geometry.packed_shapes`, each inside one of `balls` (m, 4)."""

    parts: Array
    balls: Array


MAX_VOXELS = 100_000_000
"""Most voxels of a map."""
_DIAGONAL = 3.0**0.5 / 2.0
"""From the centre of a voxel to its corner, in widths."""


@dataclass(frozen=True)
class Seen:
    """What an image has done: pixels with a depth, pixels of the robot, pixels in the map, and voxels that it freed. `depth` (h, w) has the depths that
    count, and is 0 elsewhere; `of_robot` (h, w) is 1 where a pixel is the robot.
    """

    valid: int
    robot: int
    marking: int
    freed: int
    depth: Depth
    of_robot: Mask

    def mask(self) -> NDArray[np.uint8]:
        """What each pixel is, see `COUNTS`, thinned out by `mask_step`."""
        step = mask_step(self.depth.shape[1])
        counts = np.where(self.depth[::step, ::step] > 0.0, np.uint8(COUNTS), np.uint8(0))
        return np.where(self.of_robot[::step, ::step] > 0, np.uint8(OF_ROBOT), counts)


class VoxelMap:
    """The voxels of a box from `lower` to `upper` (3,) in m, base frame, `resolution` (m) wide. With `unseen_occupied` a voxel is
    occupied until a camera has seen through it. Not thread-safe.
    """

    def __init__(self, lower: Array, upper: Array, resolution: float, *, unseen_occupied: bool = False) -> None:
        self.lower, self.upper, self.resolution = np.asarray(lower, float), np.asarray(upper, float), resolution
        self.unseen_occupied = unseen_occupied
        shape = np.maximum(1, np.ceil((self.upper - self.lower) / resolution - 1e-6)).astype(int)
        self._blocks = tuple(int(n) for n in -(-shape // BLOCK))
        self._grid = Grid(
            np.full(shape, UNSEEN, np.uint8),
            np.zeros(shape, np.int32),
            np.zeros(shape, np.int32),
            np.zeros(shape, np.uint8),
            np.ones(self._blocks, np.uint8),
            self.lower + resolution / 2.0,
            resolution,
        )
        self._images = 0

    def integrate(self, depth: Depth, view: View, robot: RobotShape, padding: float) -> Seen:
        """Take an image (h, w), without what is within `padding` (m) of the robot."""
        self._images += 1
        counted = np.empty_like(depth)
        cleaned(depth, view, counted)
        mask = np.zeros(depth.shape, np.uint8)
        mask_robot(counted, view, robot.parts, robot.balls, padding, mask)
        touching = _DIAGONAL * self.resolution
        take_out(self._grid, robot.parts, robot.balls, touching, OCCUPIED)  # nothing else is where it is
        if self.unseen_occupied:  # nor where no image could show anything
            take_out(self._grid, robot.parts, robot.balls, touching + padding, UNSEEN)
        marking = mark(self._grid, counted, view, mask, self._images)
        through = np.empty_like(counted)
        filled(counted, through)
        freed = clear(self._grid, least_depths(through), view, self._images, self.unseen_occupied)
        return Seen(int(np.count_nonzero(counted)), int(mask.sum()), marking, freed, counted, mask)

    def take_out(self, shape: RobotShape, padding: float) -> None:
        """Free what is within `padding` (m) of a shape: it was seen before that was known."""
        take_out(self._grid, shape.parts, shape.balls, padding + self.resolution / 2.0, OCCUPIED)

    def forget(self) -> None:
        """Make everything unseen."""
        self._grid.changed[:] = 1
        self._grid.state[:] = UNSEEN
        self._grid.passed[:] = 0

    def load(self, states: NDArray[np.uint8], first: tuple[int, int, int]) -> int:
        """Replace the map by voxels (nx, ny, nz), of which the first is at the index `first`, which may be outside. Returns how many occupied ones lie
        outside the box.
        """
        self.forget()
        here = tuple(slice(max(0, f), max(0, f + n)) for f, n in zip(first, states.shape, strict=True))
        target = self._grid.state[here]
        there = tuple(slice(max(0, -f), max(0, -f) + n) for f, n in zip(first, target.shape, strict=True))
        target[:] = states[there]
        return int(np.count_nonzero(states == OCCUPIED) - np.count_nonzero(target == OCCUPIED))

    @property
    def occupied(self) -> Cells:
        """Which voxels (nx, ny, nz) are occupied."""
        state = self._grid.state
        return np.asarray(state != FREE if self.unseen_occupied else state == OCCUPIED)

    @property
    def states(self) -> NDArray[np.uint8]:
        """The state (nx, ny, nz) of each voxel: unseen, free or occupied."""
        return self._grid.state

    def changes(self) -> Iterator[tuple[BlockIndex, Array, Cells]]:
        """The blocks that have changed since the last call, at first all: index, centre of the first voxel (3,), and which voxels
        (up to 16, 16, 16) are occupied.
        """
        occupied = self.occupied
        for index in np.argwhere(self._grid.changed):
            first = index * BLOCK
            i, j, k = (slice(n, n + BLOCK) for n in first)
            yield (
                (int(index[0]), int(index[1]), int(index[2])),
                self._grid.origin + first * self.resolution,
                occupied[i, j, k],
            )
        self._grid.changed[:] = 0
