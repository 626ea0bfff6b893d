"""Proves that the first joints cannot get from start to goal, wherever the other joints are.

The positions of the first joints determine those of balls inside the links that they carry. A cell of a grid over these
joints is in collision if one of the balls overlaps an obstacle throughout the cell. If the other cells do not connect
the start to the goal, no path does. (Basch, Guibas, Hsu and Nguyen, "Disconnection proofs for motion planning", 2001.)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zarm_geometry import packed_shapes
from zarm_geometry.allowed_collisions import EVERY_LINK
from zarm_geometry.kernels.kinematics import frames
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.deadline import Deadline
from zarm_trajectory.arrays import Array

Cells = NDArray[np.int64]

_CELLS = (720, 4000, 24000)
"""Most cells for the ranges of the first joint, the first two and the first three."""
_LOOK_AT = 128
"""Cells evaluated in one batch."""
_MOST_SHAPES = 64
"""Obstacles may consist of any number of shapes; only the largest count."""
_SMALLEST = 0.02
"""Smaller balls (radius in m) prove next to nothing."""
_ALONG = np.linspace(-0.9, 0.9, 5)
"""Places of ball centres along the middle of a shape, as shares of half its length."""
_ON_AXIS = np.linspace(-0.5, 0.5, 21)
"""The same along the axis of a joint, in m from its origin."""


@dataclass(frozen=True)
class Disconnection:
    """The start and the goals lie in different components, even if nothing but the robot's first `joints` could
    collide, and with nothing but the `objects`.
    """

    joints: tuple[str, ...]
    objects: tuple[str, ...]


@dataclass(frozen=True)
class _Balls:
    """Balls inside the robot: the `joint` (n,) that carries each, its `centre` (n, 3) in that joint's frame, its
    `radius` (n,).

    Those marked `held` (n,) lie on the axis of the joint, which therefore does not move them.
    """

    joint: NDArray[np.int32]
    centre: Array
    radius: Array
    held: NDArray[np.bool_]

    def before(self, count: int) -> _Balls:
        """The balls whose place is determined by the first `count` joints."""
        chosen = self.joint < count + self.held
        return _Balls(self.joint[chosen], self.centre[chosen], self.radius[chosen], self.held[chosen])


def find_disconnection(
    model: RobotModel, world: World, starts: Array, goals: Array, deadline: Deadline
) -> Disconnection | None:
    """Why no path leads from any of `starts` (n, dof) to any of `goals` (m, dof).

    None if that is not proven by the deadline, at which it returns.
    """
    every = np.flatnonzero(world.arrays.checked == EVERY_LINK)  # what some links may touch proves nothing
    if not len(every):
        return None
    lower, upper = packed_shapes.bounds(world.rows[every])
    widest = np.sort(upper - lower, axis=1)[:, 1:].prod(axis=1)
    largest = every[np.argsort(-widest, kind="stable")[:_MOST_SHAPES]]
    shapes, owner = world.rows[largest], world.owner[largest]
    balls = _inner_balls(model)
    for count in range(1, min(len(_CELLS), model.dof) + 1):
        grid = _Grid(model, shapes, balls.before(count), count)
        hit = grid.part(grid.cells(starts), grid.cells(goals), deadline)
        if hit is not None:
            names = model.robot.descriptor.joints[:count]
            return Disconnection(tuple(names), tuple(sorted({world.names[index] for index in owner[hit]})))
    return None


class _Grid:
    """The ranges of the first joints in cells; `blocked` says whether one is proven to hold nothing free."""

    def __init__(self, model: RobotModel, shapes: Array, balls: _Balls, count: int) -> None:
        # A continuous joint has the cells of one turn, and its last one is beside its first.
        self._turning = model.continuous[:count]
        lower, upper = np.where(model.continuous, ((-np.pi,), (np.pi,)), (model.lower, model.upper))[:, :count]
        span = upper - lower
        # Cells have about the same edge length in every joint.
        edge = (np.prod(span) / _CELLS[count - 1]) ** (1 / count)
        self._shape = np.maximum(1, np.floor(span / edge)).astype(np.int64)
        self._lower, self._size = lower, span / self._shape
        self._model, self._shapes, self._balls, self._count = model, shapes, balls, count

    def cells(self, q: Array) -> Cells:
        """The cells (n,) that contain joints (n, dof)."""
        at = np.floor((q[:, : self._count] - self._lower) / self._size).astype(np.int64)
        return self._number(np.where(self._turning, at % self._shape, np.clip(at, 0, self._shape - 1)))

    def part(self, starts: Cells, goals: Cells, deadline: Deadline) -> NDArray[np.intp] | None:
        """The shapes that separate the starts from the goals; None if they are connected, or at the deadline.

        Both sides grow alternately, the cells nearest to the other side first: a small side is soon complete.
        """
        side = np.zeros(int(np.prod(self._shape)), np.int8)
        blocked_by = np.full(len(side), -1)
        side[goals], side[starts] = 2, 1
        if np.any(side[goals] == 1):
            return None
        frontier = {1: np.unique(starts), 2: np.unique(goals)}
        towards = {1: self._at(goals)[0], 2: self._at(starts)[0]}
        while not deadline.passed:
            for mine, cells in frontier.items():
                away = np.abs(self._at(cells) - towards[mine]).sum(axis=1)
                order = np.argsort(away, kind="stable")
                fresh = self._beside(cells[order[:_LOOK_AT]])
                if np.any(side[fresh] == 3 - mine):
                    return None
                fresh = fresh[(side[fresh] == 0) & (blocked_by[fresh] < 0)]
                if len(fresh):
                    blocked_by[fresh] = self.blocked_by(fresh)
                free = fresh[blocked_by[fresh] < 0]
                side[free] = mine
                frontier[mine] = np.concatenate([cells[order[_LOOK_AT:]], free])
                if not len(frontier[mine]):
                    around = blocked_by[self._beside(np.flatnonzero(side == mine))]
                    return np.unique(around[around >= 0])
        return None

    def _at(self, cells: Cells) -> Cells:
        """Row, column and so on (n, count) of cells (n,)."""
        return np.stack(np.unravel_index(cells, self._shape), axis=1)

    def _number(self, at: Cells) -> Cells:
        return np.asarray(np.ravel_multi_index(tuple(at.T), tuple(self._shape)), np.int64)

    def _beside(self, cells: Cells) -> Cells:
        """The cells that share a face with one of the given cells, each once."""
        step = np.eye(self._count, dtype=np.int64)
        at = (self._at(cells)[:, None] + np.concatenate([step, -step])).reshape(-1, self._count)
        at = np.where(self._turning, at % self._shape, at)
        return np.unique(self._number(at[np.all((at >= 0) & (at < self._shape), axis=1)]))

    def blocked_by(self, cells: Cells) -> NDArray[np.intp]:
        """For each of the cells (n,) a shape that some ball overlaps throughout the cell; -1 if there is none."""
        model, balls, half = self._model, self._balls, self._size / 2
        q = np.zeros((len(cells), model.dof))
        q[:, : self._count] = self._lower + (self._at(cells) + 0.5) * self._size
        moving = np.empty((len(cells), model.dof, 4, 4))
        frames(
            model.tree.table,
            model.origin,
            np.arange(model.dof, dtype=np.int32),
            np.repeat(np.eye(4)[None], model.dof, axis=0),
            q,
            moving,
        )
        carried = moving[:, balls.joint]
        centre = np.einsum("nbij,bj->nbi", carried[..., :3, :3], balls.centre) + carried[..., :3, 3]
        # Let the joints turn one after the other, the last first: then each turns about its axis at the cell's centre.
        moved = np.zeros(centre.shape[:2])
        for joint in reversed(range(self._count)):
            if model.revolute[joint]:
                arm = centre - moving[:, None, joint, :3, 3]
                axis = moving[:, None, joint, :3, 2]
                lever = np.linalg.norm(np.cross(arm, axis), axis=-1) + moved
            else:
                lever = np.ones_like(moved)
            moved += np.where(balls.joint >= joint, half[joint] * lever, 0.0)
        distance = packed_shapes.distances(centre.reshape(-1, 3), self._shapes).reshape(*moved.shape, -1)
        distance = (distance + (moved - balls.radius)[..., None]).min(axis=1)
        nearest = np.argmin(distance, axis=1)
        return np.where(distance[np.arange(len(cells)), nearest] < 0.0, nearest, -1)


def _inner_balls(model: RobotModel) -> _Balls:
    """Balls inside the robot's exact shapes, along the middle of each shape and along the axis of the joint that
    carries it.
    """
    found: list[tuple[int, Array, Array]] = []
    for body in model.bodies:
        if body.joint < 0:
            continue
        for shape in body.shapes:
            pose = body.pose @ shape.pose
            row = np.array([*np.linalg.inv(pose)[:3].ravel(), *shape.core, shape.disc, shape.rounding])[None]
            along = np.zeros((len(_ALONG), 3))
            longest = int(np.argmax(shape.half))
            along[:, longest] = _ALONG * shape.half[longest]
            middle = along @ pose[:3, :3].T + pose[:3, 3]
            axis = np.outer(_ON_AXIS, (0.0, 0.0, 1.0))
            points = np.concatenate([middle, axis]) if model.revolute[body.joint] else middle
            found.append((body.joint, points, -packed_shapes.distances(points, row)[:, 0]))
    joint = np.array([joint for joint, points, _ in found for _ in points], np.int32)
    centre = np.concatenate([points for _, points, _ in found] or [np.empty((0, 3))])
    radius = np.concatenate([depth for *_, depth in found] or [np.empty(0)])
    held = ~centre[:, :2].any(axis=1) & model.revolute[joint]
    large = radius > _SMALLEST
    return _Balls(joint[large], centre[large], radius[large], held[large])
