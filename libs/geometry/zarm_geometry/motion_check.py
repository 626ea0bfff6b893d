"""Whether a timed motion keeps a margin to everything: what stands, what moves, and the robot itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import Attached, SceneObject, Vector3
from zarm_geometry import rows
from zarm_geometry.exact import obstacles, robot_parts, subjects
from zarm_geometry.kernels.clearance import Obstacles, RobotParts
from zarm_geometry.kernels.motion import Movers, first_contact, motion
from zarm_geometry.meshes import Meshes
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World, convex_shapes

Array = NDArray[np.float64]

FARTHEST = 0.1
"""Clearance (m) beyond the margin that a verdict does not tell apart."""
_OVERSHOOT = 1.01
"""Trajectories may accelerate by this factor more than the joints' limits say, as `zarm_trajectory.limits` has it."""


@dataclass(frozen=True)
class MotionVerdict:
    """What is proven of a motion.

    `free`: it keeps the margin from its first sample to its last. If not, it does so up to `contact_time` (s, on the motion's
    own clock; its first time where already the start is too near), and `link` comes too near to `object`, a scene object or
    another link. `clearance` (m) is a lower bound of the distance up to there, capped at FARTHEST beyond the margin.
    """

    free: bool
    contact_time: float | None
    object: str | None
    link: str | None
    clearance: float


@dataclass(frozen=True)
class MovingObject:
    """An object that was seen at the pose of `object` at `time` (s, on the clock of the motions that are checked).

    At any other time it is displaced by `velocity` (m/s, base frame) times what has passed, and each of its points anywhere
    within `speed` (m/s) times that of there. For an object that moves in any way, but no faster than v, leave `velocity` zero and
    say v as `speed`.
    """

    object: SceneObject
    velocity: Vector3 = (0.0, 0.0, 0.0)
    speed: float = 0.0
    time: float = 0.0


@dataclass(frozen=True)
class _Body:
    """A robot with what is attached to it, for the kernel."""

    model: RobotModel
    parts: RobotParts
    asked: NDArray[np.bool_]

    @classmethod
    def of(cls, model: RobotModel) -> Self:
        parts, _ = robot_parts(model)
        return cls(model, parts, subjects(model, parts))


@dataclass(frozen=True)
class _Scene:
    """A world, less the rows that are not `alive` (n,), and the shapes of the objects that changed since it was made."""

    world: World
    obstacles: Obstacles
    alive: NDArray[np.bool_]
    changed: dict[str, Array] = field(default_factory=dict)


class MotionCheck:
    """Checks motions of one robot in a world that changes; any number of threads may check while one changes it.

    It computes on the exact shapes of robot and objects, without the GIL, see `kernels.motion`.
    """

    def __init__(self, model: RobotModel, meshes: Meshes | None = None) -> None:
        self.model, self._meshes = model, meshes or Meshes()
        self._bodies: dict[tuple[tuple[Attached, ...], tuple[str, ...]], _Body] = {}
        self.set_world(World((), 0.0))

    def set_world(self, world: World) -> None:
        """Check in this world from now on; its margin is not added to that of the checks."""
        self._scene = _Scene(world, obstacles(world), np.ones(len(world.rows), np.bool_))

    def update(self, changed: Sequence[SceneObject], removed: Sequence[str] = ()) -> None:
        """Put objects into the world, in place of those of the same names, and take others out; unknown names do not matter.

        It costs far less than a new world. But changed objects are not in its tree: after some hundreds a new world is faster.
        """
        scene = self._scene
        names = {item.name for item in changed} | set(removed)
        gone = [index for index, name in enumerate(scene.world.names) if name in names]
        alive = scene.alive & ~np.isin(scene.world.owner, gone)
        others = {name: shapes for name, shapes in scene.changed.items() if name not in names}
        fresh = {item.name: convex_shapes([item], self._meshes)[0] for item in changed}
        self._scene = _Scene(scene.world, scene.obstacles, alive, others | fresh)

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
    ) -> MotionVerdict:
        """Whether a motion keeps `margin` (m, above 0) to all objects and between the robot's own links.

        `times` (N,) in s increase; `positions` (N, dof) in rad (m where prismatic). Between two samples a joint may do whatever
        its `acceleration` (dof,) in rad/s^2 allows, by default the limits of the robot: what is proven holds there, too, and so
        samples that are 4 to 20 ms apart are best. Motions that are closer than the margin by 1 mm less than that may be called not
        free. `attached` objects and `ignored_links` are as in the scene. Raises InvalidRequest for arrays that do not fit.
        """
        time, q = np.array(times, np.float64, ndmin=1), np.array(positions, np.float64, order="C", ndmin=2)
        if q.shape != (len(time), self.model.dof) or not (np.isfinite(time).all() and np.isfinite(q).all()):
            raise InvalidRequest(f"a motion needs a finite time and {self.model.dof} finite positions for each sample")
        if len(time) == 1:
            time, q = np.repeat(time, 2) + (0.0, 1e-6), np.repeat(q, 2, axis=0)
        if not np.all(np.diff(time) > 0.0):
            raise InvalidRequest("the times of a motion must increase")
        body, scene = self._body(tuple(attached), tuple(ignored_links)), self._scene
        limit = _OVERSHOOT * self.model.acceleration if acceleration is None else np.asarray(acceleration, np.float64)
        names, movers = self._movers(scene, moving)
        until, part, other, clearance = first_contact(
            body.parts,
            scene.obstacles,
            scene.alive,
            movers,
            body.asked,
            motion(body.parts, time, q, limit),
            margin,
            margin + FARTHEST,
        )
        if until == len(time) - 1:
            return MotionVerdict(True, None, None, None, clearance)
        link = body.model.links[body.model.parts[part][0]]
        if other < 0:
            near = body.model.links[body.model.parts[-1 - other][0]]
        elif other < len(scene.alive):
            near = scene.world.names[scene.world.owner[other]]
        else:
            near = names[other - len(scene.alive)]
        return MotionVerdict(False, float(time[until]), near, link, clearance)

    def _body(self, attached: tuple[Attached, ...], ignored_links: tuple[str, ...]) -> _Body:
        key = (attached, ignored_links)
        if key not in self._bodies:
            self._bodies = {key: _Body.of(self.model.with_attached(attached, ignored_links))}
        return self._bodies[key]

    def _movers(self, scene: _Scene, moving: Sequence[MovingObject]) -> tuple[list[str], Movers]:
        """What the world's tree does not hold, and the name of the object that each row of it is part of."""
        if not moving and not scene.changed:
            return [], _NONE
        tables = [*scene.changed.values(), *(convex_shapes([item.object], self._meshes)[0] for item in moving)]
        names = [*scene.changed, *(item.object.name for item in moving)]
        states = [(0.0,) * 5] * len(scene.changed) + [(*item.velocity, item.speed, item.time) for item in moving]
        counts = [len(table) for table in tables]
        state = np.repeat(np.array(states), counts, axis=0)
        shapes = np.concatenate(tables)
        return [name for name, count in zip(names, counts, strict=True) for _ in range(count)], Movers(
            shapes, state[:, :3].copy(), state[:, 3].copy(), state[:, 4].copy(), *rows.bounds(shapes)
        )


_NONE = Movers(*(np.zeros(shape) for shape in ((0, rows.WIDTH), (0, 3), 0, 0, (0, 3), (0, 3))))
