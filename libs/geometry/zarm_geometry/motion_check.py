"""Whether a timed motion keeps a margin to static and moving objects and to the robot itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import Attached, SceneObject, Vector3
from zarm_geometry import rows
from zarm_geometry.exact import obstacles, robot_parts, room, subjects
from zarm_geometry.kernels.course import Obstacles
from zarm_geometry.kernels.motion import Flags, MotionBody, Movers, Solids, first_contact, motion, motion_body, solids
from zarm_geometry.kernels.nearby import GRADIENT, near
from zarm_geometry.meshes import Meshes
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World, convex_shapes

Array = NDArray[np.float64]

MOST_PAIRS = 64
"""Most world rows and pairs of links distinguished near one configuration."""
_LEAST_ROOM = 0.002
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

    `gradient` (dof,) in m/rad (m/m if prismatic) is its derivative by each joint. Of a margin they can keep `room` (m).
    """

    distance: float
    link: str
    object: str
    gradient: Array
    room: float = np.inf


@dataclass(frozen=True)
class MovingObject:
    """An object observed at the pose of `object` at `time` (s, on the clock of the checked motions).

    At any other time it is displaced by `velocity` (m/s, base frame) times the elapsed time, and each of its points
    lies within `speed` (m/s) times the elapsed time of there. For an object that moves arbitrarily, but no faster than
    v, leave `velocity` zero and give v as `speed`.
    """

    object: SceneObject
    velocity: Vector3 = (0.0, 0.0, 0.0)
    speed: float = 0.0
    time: float = 0.0


@dataclass(frozen=True)
class _Body:
    """A robot with its attached objects, for the kernel; `outward` is not checked against itself."""

    model: RobotModel
    packed: MotionBody
    outward: MotionBody

    @classmethod
    def of(cls, model: RobotModel) -> Self:
        parts, _ = robot_parts(model)
        asked, kept = subjects(model, parts), np.maximum(room(model), _LEAST_ROOM)
        outward = asked & (np.arange(len(asked)) < len(model.links))
        return cls(model, motion_body(parts, asked, kept), motion_body(parts, outward, kept))

    def room(self, part: int, other: int) -> float:
        """How much of a margin (m) two of its parts can keep; `other` is the kernels' index."""
        if other >= 0:
            return np.inf
        pair = sorted((self.model.parts[part][0], self.model.parts[-1 - other][0]))
        return self._rooms[pair[0], pair[1]]

    @cached_property
    def _rooms(self) -> dict[tuple[int, int], float]:
        pairs = map(tuple, np.sort(self.model.pairs, axis=1).tolist())
        return dict(zip(pairs, self.packed.room[len(self.model.links) :].tolist(), strict=True))


@dataclass(frozen=True)
class _Scene:
    """A world, without the rows that are not `alive` (n,), and the shapes of the objects that changed since it was
    made.
    """

    world: World
    obstacles: Obstacles
    standing: Solids
    alive: Flags
    changed: dict[str, Array] = field(default_factory=dict)


@dataclass(frozen=True)
class _Packed:
    """The shapes of changed and of moving objects in the form for checks, which often repeat with the same ones."""

    changed: dict[str, Array] = field(default_factory=dict)
    moving: list[SceneObject] = field(default_factory=list)
    names: list[str] = field(default_factory=list)
    counts: list[int] = field(default_factory=list)
    solids: Solids = field(default_factory=lambda: solids(np.zeros((0, rows.WIDTH))))
    lower: Array = field(default_factory=lambda: np.zeros((0, 3)))
    upper: Array = field(default_factory=lambda: np.zeros((0, 3)))

    @classmethod
    def of(cls, changed: dict[str, Array], moving: list[SceneObject], meshes: Meshes) -> Self:
        """Raises Unavailable for a mesh that is not in `meshes`."""
        tables = [*changed.values(), *(convex_shapes(item, meshes) for item in moving)]
        names, counts = [*changed, *(item.name for item in moving)], [len(table) for table in tables]
        shapes = np.concatenate(tables)
        each = [name for name, count in zip(names, counts, strict=True) for _ in range(count)]
        return cls(changed, moving, each, counts, solids(shapes), *rows.bounds(shapes))

    def holds(self, changed: dict[str, Array], moving: list[SceneObject]) -> bool:
        """Whether it was made of exactly these objects."""
        return self.changed is changed and list(map(id, self.moving)) == list(map(id, moving))


class MotionCheck:
    """Checks motions of one robot in a changing world; any number of threads may check while one changes it.

    It computes on the exact shapes of robot and objects, without the GIL, see `kernels.motion`.
    """

    def __init__(self, model: RobotModel, meshes: Meshes | None = None) -> None:
        self.model, self._meshes = model, meshes or Meshes()
        self._bodies: dict[tuple[tuple[Attached, ...], tuple[str, ...]], _Body] = {}
        self._packed = _Packed()
        self.set_world(World((), 0.0))

    def set_world(self, world: World) -> None:
        """From now on check in this world; its margin is not added to that of the checks."""
        self._scene = _Scene(world, obstacles(world), solids(world.rows), np.ones(len(world.rows), np.uint8))

    def update(self, changed: Sequence[SceneObject], removed: Sequence[str] = ()) -> None:
        """Put objects into the world, replacing those of the same names, and remove others; unknown names are ignored.

        This costs far less than a new world. But changed objects are not in its tree: after some hundreds a new world
        is faster.
        """
        scene = self._scene
        names = {item.name for item in changed} | set(removed)
        gone = [index for index, name in enumerate(scene.world.names) if name in names]
        alive = np.where(np.isin(scene.world.owner, gone), np.uint8(0), scene.alive)
        others = {name: shapes for name, shapes in scene.changed.items() if name not in names}
        fresh = {item.name: convex_shapes(item, self._meshes) for item in changed}
        self._scene = replace(scene, alive=alive, changed=others | fresh)

    def check(
        self,
        times: ArrayLike,
        positions: ArrayLike,
        *,
        margin: float,
        attached: Sequence[Attached] = (),
        ignored_links: Sequence[str] = (),
        moving: Sequence[MovingObject] = (),
        acceleration: ArrayLike | None = None,
        self_collision: bool = True,
    ) -> MotionVerdict:
        """Whether a motion keeps `margin` (m, above 0) to all objects and, with `self_collision`, between the robot's
        own links. Two links that are closer in nearly all configurations keep what they can, see
        `RobotModel.pair_room`.

        `times` (N,) in s increase; `positions` (N, dof) in rad (m if prismatic). Between two samples a joint may do
        whatever its `acceleration` (dof,) in rad/s^2 allows, by default the limits of the robot: the proof covers that
        too. The further apart samples are, the more a motion must keep beyond the margin to be proven free: at 6
        rad/s^2 in each joint some 0.1 mm for 4 ms and 2 mm for 20 ms. `attached` objects and `ignored_links` are as in
        the scene. Raises InvalidRequest for arrays that do not fit.
        """
        time, q = np.array(times, np.float64, ndmin=1), np.array(positions, np.float64, order="C", ndmin=2)
        if (
            len(time) == 0
            or q.shape != (len(time), self.model.dof)
            or not (np.isfinite(time).all() and np.isfinite(q).all())
        ):
            raise InvalidRequest(f"a motion needs a finite time and {self.model.dof} finite positions for each sample")
        if len(time) == 1:
            time, q = np.repeat(time, 2) + (0.0, 1e-6), np.repeat(q, 2, axis=0)
        if not np.all(np.diff(time) > 0.0):
            raise InvalidRequest("the times of a motion must increase")
        body, scene = self._body(tuple(attached), tuple(ignored_links)), self._scene
        limit = _OVERSHOOT * self.model.acceleration if acceleration is None else np.asarray(acceleration, np.float64)
        names, movers = self._movers(scene, moving)
        packed = body.packed if self_collision else body.outward
        until, part, other = first_contact(
            packed,
            scene.obstacles,
            scene.standing,
            scene.alive,
            movers,
            motion(packed, time, q, limit),
            margin,
        )
        if until == len(time) - 1:
            return MotionVerdict(True, None, None, None)
        link, near_it = _names(body, scene, names, part, other)
        return MotionVerdict(False, float(time[until]), near_it, link)

    def nearby(
        self,
        position: ArrayLike,
        *,
        within: float,
        time: float = 0.0,
        attached: Sequence[Attached] = (),
        ignored_links: Sequence[str] = (),
        moving: Sequence[MovingObject] = (),
    ) -> list[NearPair]:
        """What is closer than `within` (m) at `position` (dof,), nearest first: each link and object, and each pair of
        links, once.

        If there are more than MOST_PAIRS, the nearest count. `moving` objects are placed at `time` (s). Raises
        InvalidRequest.
        """
        q = np.array(position, np.float64, order="C")
        if q.shape != (self.model.dof,) or not np.isfinite(q).all():
            raise InvalidRequest(f"a configuration needs {self.model.dof} finite positions")
        body, scene = self._body(tuple(attached), tuple(ignored_links)), self._scene
        names, movers = self._movers(scene, moving)
        standing = motion(body.packed, time + np.array((0.0, 1.0)), np.array((q, q)), np.zeros(self.model.dof))
        found = np.empty((MOST_PAIRS, GRADIENT + self.model.dof))
        count = near(body.packed, scene.obstacles, scene.standing, scene.alive, movers, standing, within, found)
        pairs: dict[tuple[str, str], NearPair] = {}
        for row in found[np.argsort(found[:count, 0])]:
            link, other = _names(body, scene, names, int(row[1]), int(row[2]))
            kept = body.room(int(row[1]), int(row[2]))
            pairs.setdefault((link, other), NearPair(float(row[0]), link, other, row[GRADIENT:], kept))
        return list(pairs.values())

    def _body(self, attached: tuple[Attached, ...], ignored_links: tuple[str, ...]) -> _Body:
        key = (attached, ignored_links)
        if key not in self._bodies:
            self._bodies = {key: _Body.of(self.model.with_attached(attached, ignored_links))}
        return self._bodies[key]

    def _movers(self, scene: _Scene, moving: Sequence[MovingObject]) -> tuple[list[str], Movers]:
        """The shapes outside the world's tree, and the name of the object to which each row of them belongs."""
        if not moving and not scene.changed:
            return [], _NONE
        packed, objects = self._packed, [item.object for item in moving]
        if not packed.holds(scene.changed, objects):
            packed = self._packed = _Packed.of(scene.changed, objects, self._meshes)
        states = [(0.0,) * 5] * len(scene.changed) + [(*item.velocity, item.speed, item.time) for item in moving]
        state = np.repeat(np.array(states), packed.counts, axis=0)
        velocity, speed, since = state[:, :3].copy(), state[:, 3].copy(), state[:, 4].copy()
        return packed.names, Movers(packed.solids, velocity, speed, since, packed.lower, packed.upper)


def _names(body: _Body, scene: _Scene, movers: Sequence[str], part: int, other: int) -> tuple[str, str]:
    """The link to which a part belongs, and the name of the kernels' `other`."""
    link = body.model.links[body.model.parts[part][0]]
    if other < 0:
        return link, body.model.links[body.model.parts[-1 - other][0]]
    if other < len(scene.alive):
        return link, scene.world.names[scene.world.owner[other]]
    return link, movers[other - len(scene.alive)]


_NONE = Movers(solids(np.zeros((0, rows.WIDTH))), *(np.zeros(shape) for shape in ((0, 3), 0, 0, (0, 3), (0, 3))))
