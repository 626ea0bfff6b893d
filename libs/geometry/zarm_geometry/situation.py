"""A robot among static and moving objects, prepared once for all checks of its motions there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import SceneObject, Vector3
from zarm_geometry import packed_shapes
from zarm_geometry.allowed_collisions import Pairs, checked
from zarm_geometry.exact import kept_margin, obstacles, robot_parts, subjects
from zarm_geometry.kernels.clearance_search import Obstacles
from zarm_geometry.kernels.motion import NO_MOVERS, MotionBody, Movers, Solids, motion_body, solids
from zarm_geometry.kernels.situation import GRADIENT_THERE, KEPT_MARGIN, Owner, SituationArrays, contact, nearby
from zarm_geometry.meshes import Meshes
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World, convex_shapes
from zarm_trajectory.arrays import Array, Bits

_LEAST_KEPT = 0.002
"""Two links keep at least this much (m) of a margin, however close they always are."""
_OVERSHOOT = 1.01
"""Factor by which trajectories may exceed the joints' acceleration limits, as in `zarm_trajectory.limits`."""


@dataclass(frozen=True)
class MotionVerdict:
    """What is proven of a motion.

    `free`: it keeps the margin from its first to its last sample. If not, it keeps it up to `contact_time` (s, on the
    motion's own clock; its first time if even the start is too close), and `link` comes too close to `object`, a scene
    object or another link.
    """

    free: bool
    contact_time: float | None
    object: str | None
    link: str | None


@dataclass(frozen=True)
class NearPair:
    """A link that is `distance` (m, negative if they overlap) from `object`, a scene object or another link.

    `gradient` (dof,) in m/rad (m/m if prismatic) is its derivative by each joint. Of a margin they can keep `kept_margin` (m).
    """

    distance: float
    link: str
    object: str
    gradient: Array
    kept_margin: float = np.inf


@dataclass(frozen=True)
class MovingObject:
    """An object observed at the pose of `object` at `time` (s, on the clock of the checked motions).

    At any other time it is displaced by `velocity` (m/s, base frame) times the elapsed time, and each of its points
    lies within `speed` (m/s) times the elapsed time of there. For an object that moves arbitrarily, but no faster than
    v, leave `velocity` zero and give v as `speed`. All the time it is also displaced by `offset` (m, base frame), and
    inflated by `growth` (m).
    """

    object: SceneObject
    velocity: Vector3 = (0.0, 0.0, 0.0)
    speed: float = 0.0
    time: float = 0.0
    offset: Vector3 = (0.0, 0.0, 0.0)
    growth: float = 0.0


class MovableShapes(NamedTuple):
    """An object's `solids` (n), between the corners `lower` and `upper` (n, 3)."""

    item: SceneObject
    solids: Solids
    lower: Array
    upper: Array

    @classmethod
    def of(cls, item: SceneObject, meshes: Meshes) -> Self:
        """Raises Unavailable for a mesh that is not in `meshes`."""
        shapes = convex_shapes(item, meshes)
        return cls(item, solids(shapes), *packed_shapes.bounds(shapes))


@dataclass(frozen=True)
class MotionRobot:
    """A robot with its attached objects, for the kernels; `outward` is not checked against itself.

    `acceleration` (dof,) in rad/s^2 is the most that its trajectories use.
    """

    model: RobotModel
    body: MotionBody
    outward: MotionBody
    acceleration: Array

    @classmethod
    def of(cls, model: RobotModel) -> Self:
        """Pack a robot."""
        parts, _ = robot_parts(model)
        asked, kept = subjects(model, parts), np.maximum(kept_margin(model), _LEAST_KEPT)
        outward = asked & (np.arange(len(asked)) < len(model.links))
        bodies = motion_body(parts, asked, kept), motion_body(parts, outward, kept)
        return cls(model, *bodies, _OVERSHOOT * model.acceleration)


class MotionWorld:
    """A world, without the rows of the objects in `gone`, and the objects that `changed` since it was made."""

    def __init__(
        self,
        world: World,
        around: Obstacles,
        standing: Solids,
        gone: frozenset[str] = frozenset(),
        changed: Sequence[MovableShapes] = (),
    ) -> None:
        self._world, self._around, self._standing = world, around, standing
        self._gone, self._changed = gone, tuple(changed)
        indices = [index for index, name in enumerate(world.names) if name in gone]
        self._there = ~np.isin(world.owner, indices)
        self._checked = self._checked_with(())
        self._still = self._with((), ())

    @classmethod
    def of(cls, world: World) -> Self:
        """A world as it is."""
        return cls(world, obstacles(world), solids(world.rows))

    def name(self, row: int) -> str:
        """The object to which a row of the world belongs."""
        return self._world.names[int(self._world.owner[row])]

    def updated(self, changed: Sequence[MovableShapes], removed: Sequence[str]) -> Self:
        """This world with some objects added or replaced, and those named in `removed` taken out of it."""
        names = {each.item.name for each in changed} | set(removed)
        others = [each for each in self._changed if each.item.name not in names]
        return type(self)(self._world, self._around, self._standing, self._gone | names, [*others, *changed])

    def situation(self, robot: MotionRobot, moving: Sequence[tuple[MovableShapes, MovingObject]] = ()) -> Situation:
        """The situation of a robot in this world among moving objects."""
        allowed = robot.model.allowed
        names, movers, owner = self._with(moving, allowed) if moving or allowed else self._still
        kept = self._checked_with(allowed) if allowed else self._checked
        world = self._world.owner, self._around, self._standing, kept
        return Situation(robot, SituationArrays(robot.body, *world, movers, owner), self, names)

    def _checked_with(self, allowed: Pairs) -> Bits:
        """The bits of the links against which each row of the world is checked, with pairs that may touch; 0 for one that is gone."""
        masks = checked(self._world.names, allowed)[self._world.owner]
        return np.where(self._there, masks, np.uint64(0))

    def _with(
        self, moving: Sequence[tuple[MovableShapes, MovingObject]], allowed: Pairs
    ) -> tuple[list[str], Movers, Owner]:
        """What is not in the world's tree: the object of each of its rows by name, the rows, and a number for that
        object.
        """
        shapes = [*self._changed, *(each for each, _ in moving)]
        states = [(0.0,) * 9] * len(self._changed)
        states += [(*item.velocity, item.speed, item.time, *item.offset, item.growth) for _, item in moving]
        counts = [len(each.lower) for each in shapes]
        number: dict[str, int] = {}
        numbers = [number.setdefault(each.item.name, len(number)) for each in shapes]
        names = [each.item.name for each, count in zip(shapes, counts, strict=True) for _ in range(count)]
        movers = _movers(shapes, np.repeat(np.array(states).reshape(-1, 9), counts, axis=0), checked(names, allowed))
        return names, movers, np.repeat(np.array(numbers, np.intp), counts)


def _movers(shapes: Sequence[MovableShapes], state: Array, against: Bits) -> Movers:
    """Movers (n) with this `state` (n, 9), velocity, speed, time, offset and growth of a `MovingObject`, checked `against` these links."""
    pose = np.concatenate([NO_MOVERS.solids.pose, *(each.solids.pose for each in shapes)])
    extents = np.concatenate([NO_MOVERS.solids.extents, *(each.solids.extents for each in shapes)])
    lower = np.concatenate([NO_MOVERS.lower, *(each.lower for each in shapes)])
    upper = np.concatenate([NO_MOVERS.upper, *(each.upper for each in shapes)])
    offset, growth = state[:, 5:8], state[:, 8]
    pose[:, :, 3] += offset
    extents[:, 4] += growth  # the rounding
    lower += offset - growth[:, None]
    upper += offset + growth[:, None]
    return Movers(
        Solids(pose, extents), state[:, :3].copy(), state[:, 3].copy(), state[:, 4].copy(), lower, upper, against
    )


class Situation:
    """A robot among static and moving objects.

    It does not follow later changes of the world. `arrays` are what the kernels need of it.
    """

    def __init__(self, robot: MotionRobot, arrays: SituationArrays, world: MotionWorld, movers: list[str]) -> None:
        self.arrays = arrays
        self._robot, self._world, self._movers = robot, world, movers

    def check(
        self,
        times: ArrayLike,
        positions: ArrayLike,
        *,
        margin: float,
        acceleration: ArrayLike | None = None,
        self_collision: bool = True,
    ) -> MotionVerdict:
        """Whether a motion keeps `margin` (m, above 0) to all objects and, with `self_collision`, between the robot's
        own links. Two links that are closer in nearly all configurations keep what they can, see
        `RobotModel.pair_room`.

        `times` (N,) in s increase; `positions` (N, dof) in rad (m if prismatic). Between two samples a joint may do
        whatever its `acceleration` (dof,) in rad/s^2 allows, by default the limits of the robot: the proof covers that
        too. The further apart samples are, the more a motion must keep beyond the margin to be proven free: at 6
        rad/s^2 in each joint some 0.1 mm for 4 ms and 2 mm for 20 ms. Raises InvalidRequest for arrays that do not fit.
        """
        robot, dof = self._robot, self._robot.model.dof
        time, q = np.array(times, np.float64, ndmin=1), np.array(positions, np.float64, order="C", ndmin=2)
        if len(time) == 0 or q.shape != (len(time), dof) or not (np.isfinite(time).all() and np.isfinite(q).all()):
            raise InvalidRequest(f"a motion needs a finite time and {dof} finite positions for each sample")
        if len(time) == 1:
            time, q = np.repeat(time, 2) + (0.0, 1e-6), np.repeat(q, 2, axis=0)
        if not (time[1:] > time[:-1]).all():
            raise InvalidRequest("the times of a motion must increase")
        limit = robot.acceleration if acceleration is None else np.array(acceleration, np.float64)
        arrays = self.arrays if self_collision else self.arrays._replace(body=robot.outward)
        until, part, other = contact(arrays, time, q, limit, margin)
        if until == len(time) - 1:
            return MotionVerdict(True, None, None, None)
        link, near_it = self.named(part, other)
        return MotionVerdict(False, float(time[until]), near_it, link)

    def nearby(self, position: ArrayLike, *, within: float, time: float = 0.0) -> list[NearPair]:
        """What is closer than `within` (m) at `position` (dof,), nearest first: each link and object, and each pair of
        links, once.

        If there are more than MOST_PAIRS, the nearest count. Moving objects are placed at `time` (s). Raises
        InvalidRequest.
        """
        q, dof = np.array(position, np.float64, order="C"), self._robot.model.dof
        if q.shape != (dof,) or not np.isfinite(q).all():
            raise InvalidRequest(f"a configuration needs {dof} finite positions")
        return [
            NearPair(
                float(row[0]), *self.named(int(row[1]), int(row[2])), row[GRADIENT_THERE:], float(row[KEPT_MARGIN])
            )
            for row in nearby(self.arrays, q, time, within)
        ]

    def named(self, part: int, other: int) -> tuple[str, str]:
        """The link to which a part belongs, and the object or link of the kernels' `other`."""
        model = self._robot.model
        link = model.links[model.parts[part][0]]
        if other < 0:
            return link, model.links[model.parts[-1 - other][0]]
        rows = len(self.arrays.checked)
        return link, self._world.name(other) if other < rows else self._movers[other - rows]
