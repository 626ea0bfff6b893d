"""Exact distances of the robot to the scene and to itself, on the descriptor's collision primitives.

Two computations check what leaves the planner, and the smaller distance counts. `kernels.clearance` encloses all
distances along a motion between two points of the shapes and a slab between them, without relying on the convergence of
an iteration; so it proves which pairs can be excluded. FCL measures the rest: the nearest two shapes, and those whose
bounds stay apart.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from zarm_geometry.kernels.clearance import begin, look
from zarm_geometry.kernels.clearance_search import COUNT, FIRST, OTHERS, OWN, Obstacles, RobotParts, search
from zarm_geometry.kernels.convex import PRECISION
from zarm_geometry.kernels.motion import MotionBody, Solids, motion_body, solids
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.shapes import Shape, distance, nearest_points, obstacle_shape
from zarm_geometry.world import World
from zarm_trajectory.arrays import Array

RESOLUTION = 0.005
"""Along a motion whose samples are no further apart than this (m), nothing can go deeper into an object unnoticed."""
MAX_CLEARANCE = 1.0
"""Clearance (m) beyond which distances are not computed."""
_SINGLE = 1e-6
"""Relative error of the boxes of the world's tree, due to single precision."""
_INTERVALS_PER_BATCH = 500
"""Stretches of a motion checked in one batch: 0.3 ms as a rule, and not 50 among tens of thousands of obstacles."""


@dataclass(frozen=True)
class Nearest:
    """The smallest distance (m): negative for a penetration depth, and without a `pair` at MAX_CLEARANCE.

    `pair` names a link and what is nearest to it, a scene object or another link; `sample` is the index of the
    configuration. `shapes` are the indices of the two in `clearance.look`.
    """

    distance: float
    pair: tuple[str, str] | None
    sample: int
    shapes: tuple[int, int] | None = None


class ExactScene:
    """The robot's and the scene's exact geometry. Immutable, for use by any number of threads.

    The robot is packed when it is first looked at, or with `prepare`.
    """

    def __init__(self, model: RobotModel, world: World) -> None:
        """Raises ValueError if robot and world know different pairs that may touch."""
        if world.allowed not in ((), model.allowed):
            raise ValueError(f"the world allows {world.allowed} to touch, and the robot {model.allowed}")
        self.model, self.world = model, world

    def prepare(self) -> None:
        """Pack the robot now, so that no look has to wait for it."""
        _ = self._parts, self._asked

    @property
    def reach(self) -> Array:
        """How far (m) a point of the robot moves at most per rad (m if prismatic) of each joint (dof,)."""
        return self._parts[1]

    @cached_property
    def _parts(self) -> tuple[RobotParts, Array]:
        return robot_parts(self.model)

    @property
    def _body(self) -> RobotParts:
        return self._parts[0]

    @cached_property
    def _obstacles(self) -> Obstacles:
        return obstacles(self.world)

    @cached_property
    def _asked(self) -> NDArray[np.bool_]:
        return subjects(self.model, self._body)

    @property
    def _asked_of_world(self) -> NDArray[np.bool_]:
        return self._asked & (np.arange(len(self._asked)) < len(self.model.links))

    def nearest(self, q: ArrayLike, check: Callable[[], None] = lambda: None, *, itself: bool = True) -> Nearest:
        """The smallest distance, to 0.01 mm, over configurations `q` (n, dof) or for one (dof,).

        To objects and, if `itself`, between the robot's links. The search ends at the first collisions that it finds,
        so the deepest is certain only for a single configuration. Links fixed to the base are not checked against the
        world. The closer the configurations are to each other, the fewer of them need a check. `check` is called now
        and then and may raise.

        FCL's distance counts, unless two points are known that are closer to each other: for 1 in 600 random pairs of a
        capsule or cylinder and a box or cylinder, FCL's distance is more than 0.1 mm too long, by 49 mm at worst, and
        for none too short.
        """
        q = np.array(q, np.float64, order="C", ndmin=2)
        return self._nearest(q, check, self._asked if itself else self._asked_of_world, MAX_CLEARANCE)

    def is_free(self, q: ArrayLike, check: Callable[[], None] = lambda: None) -> bool:
        """Whether there is no collision at any of the configurations `q` (n, dof), or at one (dof,), as in `nearest`.

        Distances above PRECISION are not measured.
        """
        q = np.array(q, np.float64, order="C", ndmin=2)
        return self._nearest(q, check, self._asked, PRECISION).distance > 0.0

    def too_near(
        self,
        q: Array,
        clearance: float,
        margin: float,
        self_margin: float,
        check: Callable[[], None] = lambda: None,
    ) -> list[tuple[Nearest, float]]:
        """What is closer over configurations `q` (n, dof) than its required distance (m), which is also returned.

        Nothing is closer than `clearance` (m), so pairs that may come that close need no check.

        For each link its nearest object, if closer than `margin` (m), and each pair of links closer than `self_margin`
        (m), or than `RobotModel.pair_room` if that is less.
        """
        links = len(self.model.links)
        kept, found = (
            np.minimum(np.repeat((margin, self_margin), (links, len(self._asked) - links)), kept_margin(self.model)),
            [],
        )
        for within in np.unique(kept[kept > max(clearance, 0.0)]).tolist():
            asked = self._asked & (kept == within)
            while (nearest := self._nearest(q, check, asked, within)).shapes is not None:
                found.append((nearest, within))
                asked[self._subject(*nearest.shapes)] = False
        return found

    def _subject(self, part: int, other: int) -> int:
        """The index of the subject that contains these two in `clearance.look`."""
        link = self.model.parts[part][0]
        if other >= 0:
            return link
        pair = sorted((link, self.model.parts[-1 - other][0]))
        return len(self.model.links) + int(np.flatnonzero((self.model.pairs == pair).all(axis=1))[0])

    def _nearest(self, q: Array, check: Callable[[], None], asked: NDArray[np.bool_], within: float) -> Nearest:
        """The smallest distance below `within` (m) of the subjects marked in `asked`; without a pair if there is none."""
        near = self.bounds(q, check, asked, within)
        best = Nearest(within, None, 0)
        for lower, upper, *which in near[np.argsort(near[:, 0], kind="stable")].tolist():
            if lower >= best.distance - PRECISION:
                break
            check()
            part, other, sample = map(int, which)
            exact = lower == upper > PRECISION  # one of the two is a ball
            measured = upper if exact else self._measure(q[sample], part, other, upper)
            if measured < best.distance:
                best = Nearest(measured, self._names(part, other), sample, (part, other))
        return best

    def nearest_points(self, q: Array, nearest: Nearest) -> Array | None:
        """The points (2, 3) in the base frame between which `nearest`, found at `q` (dof,), is measured.

        None if nothing is near or the two overlap.
        """
        return None if nearest.shapes is None else nearest_points(*self._placed(q, *nearest.shapes))

    @cached_property
    def solids(self) -> tuple[MotionBody, Obstacles, Solids]:
        """The same robot and obstacles for `kernels.nearby`."""
        return motion_body(self._body, self._asked, kept_margin(self.model)), self._obstacles, solids(self.world.rows)

    def bounds(
        self, q: Array, check: Callable[[], None], asked: NDArray[np.bool_], within: float = MAX_CLEARANCE
    ) -> Array:
        """Rows (m, 5) of `clearance.look` that include the smallest distance over `q` (n, dof), if it is below `within`
        (m).
        """
        if not len(q):
            return np.empty((0, 5))
        motion = search(self._body, np.ascontiguousarray(q), asked)
        found, smallest = begin(
            self._body, self.model.cover, self._obstacles, self.world.arrays.shapes, motion, asked, within
        )
        over, looks = False, [found]
        while not over:
            check()
            found, smallest, over = look(self._body, self._obstacles, motion, smallest, _INTERVALS_PER_BATCH)
            looks.append(found)
        return np.concatenate(looks)

    def _names(self, part: int, other: int) -> tuple[str, str]:
        """Names of a part and the `other` of `clearance.look`."""
        name = self.world.names[self.world.owner[other]] if other >= 0 else self.model.parts[-1 - other][1].name
        return self.model.parts[part][1].name, name

    def _measure(self, q: Array, part: int, other: int, upper: float) -> float:
        """Exact distance (m) between a part and `other` of `clearance.look`, given the upper bound `upper`."""
        shape, pose, other_shape, other_pose = self._placed(q, part, other)
        return distance(shape, pose, other_shape, other_pose, upper)

    def _placed(self, q: Array, part: int, other: int) -> tuple[Shape, Array, Shape, Array]:
        """A part and the `other` of `clearance.look`, with their poses (4, 4) in the base frame at `q` (dof,)."""
        links = self.model.link_transforms(q)
        link, shape = self.model.parts[part]
        if other >= 0:
            found = obstacle_shape(self.world.names[self.world.owner[other]], self.world.rows[other])
            return shape, links[link] @ shape.pose, found, found.pose
        other_link, other_shape = self.model.parts[-1 - other]
        return shape, links[link] @ shape.pose, other_shape, links[other_link] @ other_shape.pose


def obstacles(world: World) -> Obstacles:
    """The world for kernels that compute with exact shapes."""
    arrays = world.arrays
    error = _SINGLE * float(np.abs(arrays.boxes).max(initial=0.0))
    return Obstacles(world.rows, arrays.boxes, arrays.skip, arrays.leaf, arrays.checked, error)


def subjects(model: RobotModel, body: RobotParts) -> NDArray[np.bool_]:
    """Which subjects (subjects,) of `RobotParts.reach` to check: moving links against the world, and pairs of links."""
    there = np.diff(body.first) > 0
    return np.concatenate([there & (model.link_joint >= 0), there[model.pairs].all(axis=1)])


def kept_margin(model: RobotModel) -> Array:
    """The distance (subjects,) in m that each subject can be required to keep: see `RobotModel.pair_room`."""
    known = dict(zip(map(tuple, model.arrays.pairs.tolist()), model.pair_room, strict=True))
    return np.array([np.inf] * len(model.links) + [known.get(tuple(pair), np.inf) for pair in model.pairs.tolist()])


def robot_parts(model: RobotModel) -> tuple[RobotParts, Array]:
    """The model's parts for such kernels, and `ExactScene.reach`."""
    link = np.array([link for link, _ in model.parts], np.intp)
    first = np.searchsorted(link, np.arange(len(model.links) + 1)).astype(np.int32)
    shapes = [shape for _, shape in model.parts]
    pose = np.array([shape.pose for shape in shapes]).reshape(-1, 4, 4)
    extents = np.array([(*shape.core, shape.disc, shape.rounding, shape.radius) for shape in shapes]).reshape(-1, 6)
    far = np.linalg.norm((model.offset[link] @ pose)[:, :3, 3], axis=1) + extents[:, 5]
    around, spread = np.zeros((len(model.links), 4)), np.zeros(len(model.links))
    paths, beyond = _paths(model)
    reach = np.zeros((len(paths), model.dof))
    movers = [*range(len(model.links)), *model.pairs[:, 1].tolist()]
    for i in np.flatnonzero(np.diff(first)).tolist():
        parts = slice(first[i], first[i + 1])
        centers, radii = pose[parts, :3, 3], extents[parts, 5]
        around[i, :3] = ((centers.T - radii).min(axis=1) + (centers.T + radii).max(axis=1)) / 2
        away = np.linalg.norm(centers - around[i, :3], axis=1)
        around[i, 3], spread[i] = np.max(away + radii), np.max(away + radii - extents[parts, 4])
    for subject, (path, mover) in enumerate(zip(paths, movers, strict=True)):
        parts = slice(first[mover], first[mover + 1])
        reach[subject] = _reach(model, path, far[parts].max(initial=0.0), model.link_joint[mover])
    body = RobotParts(
        tree=model.tree.table,
        origin=model.origin,
        offset=model.offset[: len(model.links)],
        around=around,
        spread=spread,
        first=first,
        pose=pose,
        extents=extents,
        pairs=model.pairs,
        reach=reach,
        paths=_table(model, paths, beyond),
        bit=model.arrays.bit,
    )
    return body, reach[: len(model.links)].max(axis=0, initial=0.0)


def _paths(model: RobotModel) -> tuple[list[list[int]], list[tuple[int, int]]]:
    """The joints of each subject in `RobotParts.paths`, and what is in OWN and OTHERS."""
    inwards = [model.ancestors(joint) for joint in model.link_joint.tolist()]
    paths = [*inwards]
    beyond = [(path[-1] if path else -1, -1) for path in inwards]
    for first, second in model.pairs.tolist():
        # Both links are moved as one by the joints up to the last common one.
        own = [joint for joint in inwards[second] if joint not in inwards[first]]
        others = [joint for joint in inwards[first] if joint not in inwards[second]][::-1]
        paths.append(own + others)
        beyond.append((own[-1] if own else -1, others[0] if others else -1))
    return paths, beyond


def _table(model: RobotModel, paths: list[list[int]], beyond: list[tuple[int, int]]) -> NDArray[np.int32]:
    """`RobotParts.paths`."""
    table = np.full((len(paths), FIRST + model.dof), -1, np.int32)
    for row, path, (own, others) in zip(table, paths, beyond, strict=True):
        row[COUNT], row[OWN], row[OTHERS] = len(path), own, others
        row[FIRST : FIRST + len(path)] = path
    return table


def _reach(model: RobotModel, path: Sequence[int], extent: float, carrier: int) -> Array:
    """How far (dof,) a point moves at most per rad (m if prismatic) of each joint along a path from its carrier, where it
    is within `extent` m of the carrier's frame.

    From there on, as if the robot could always be fully stretched.
    """
    reach = np.zeros(model.dof)
    inwards = model.ancestors(carrier)
    for joint in path:
        if joint not in inwards:
            extent += model.stretch[joint]
        reach[joint] = extent if model.revolute[joint] else 1.0
        if joint in inwards:
            extent += model.stretch[joint]
    return reach
