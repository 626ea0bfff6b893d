"""Moving objects: their last published poses, and how far they may have moved since."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from zarm_contract.codec import decode
from zarm_contract.errors import InvalidRequest, Problem, ZarmError
from zarm_contract.messages import ObjectPose, SceneObject, Sphere, Vector3, Voxels
from zarm_geometry import packed_shapes
from zarm_geometry.meshes import Meshes
from zarm_geometry.situation import MovingObject
from zarm_geometry.world import convex_shapes
from zarm_runtime import clock
from zarm_servo.refusal import Refusal
from zarm_servo.world.scene_monitor import SceneMonitor, SceneSnapshot

AGREE = 0.02
"""Greatest difference (s) between the clocks of the pose publishers and that of the servo."""
LOST = 1.0
"""An object without a pose for this long (s) is lost: it may be anywhere it could reach within that time."""
_SHAPES = 500
"""A mesh of more convex shapes than this cannot move."""
_FARTHEST, _FASTEST = 1000.0, 100.0
"""m; m/s or rad/s. Larger numbers are in another unit, or the result of a division by zero."""
_PIECES = 50
"""Most copies of an object used to cover what it sweeps."""


@dataclass(frozen=True)
class Mover:
    """The scene's `item`, reported at the pose of `placed` at the moment `seen` (s, monotonic; early rather than late).

    From there it moves with `velocity` (m/s, base frame), and each of its points by up to `speed` (m/s) more. `stamp`
    is that of the pose.
    """

    item: SceneObject
    placed: SceneObject
    velocity: Vector3
    speed: float
    seen: float
    stamp: float

    def age(self, now: float) -> float:
        """How long (s) it has been moving at `now` (s, monotonic), at most LOST."""
        return min(now - self.seen, LOST)

    def moving(self, now: float, ahead: float = 0.0, scale: float = 1.0) -> MovingObject:
        """The object for checking a motion that begins `ahead` s after `now` (s, monotonic) and runs at `scale` times
        its speed.
        """
        x, y, z = self.velocity
        return MovingObject(
            self.placed, (x / scale, y / scale, z / scale), self.speed / scale, -scale * (self.age(now) + ahead)
        )

    def swept(self, now: float, ahead: float, fineness: float) -> list[MovingObject]:
        """What it may occupy from `now` (s, monotonic) until `ahead` s later: copies of it that stand and are inflated.

        The copies are at most twice the `fineness` (m) apart, or further if the object is so fast that there would be
        too many.
        """
        first, fast = self.age(now), math.sqrt(sum(v * v for v in self.velocity))
        count = min(max(1, math.ceil(fast * ahead / (2 * fineness))), _PIECES)
        step = ahead / count
        found = []
        for k in range(count):
            middle = first + (k + 0.5) * step
            x, y, z = self.velocity
            growth = fast * step / 2 + self.speed * (first + (k + 1) * step)
            found.append(MovingObject(self.placed, offset=(x * middle, y * middle, z * middle), growth=growth))
        return found


class MovingObjects:
    """Takes the poses of objects in the scene of `monitor`, and calls `changed` after each. Thread-safe."""

    def __init__(self, monitor: SceneMonitor, meshes: Meshes, changed: Callable[[], None]) -> None:
        self._monitor, self._meshes, self._changed = monitor, meshes, changed
        self._lock = threading.Lock()
        self._movers: dict[str, Mover] = {}
        self._all: tuple[Mover, ...] = ()
        self._scene: SceneSnapshot | None = None
        self._refusal = Refusal()

    @property
    def refused(self) -> Problem | None:
        """Why a pose was refused."""
        return self._refusal.problem

    def __bool__(self) -> bool:
        """Whether any object moves."""
        return bool(self._movers)

    def receive(self, key: str, payload: bytes) -> None:
        """Take a message on the key of an object's pose."""
        self.update_object(key.split("/")[-2], payload, clock.monotonic(), clock.unix_time())

    def update_object(self, name: str, payload: bytes, now: float, wall: float) -> None:
        """Take a pose of the object `name`, unless it is refused, at `now` (s, monotonic) or `wall` (s, Unix time)."""
        try:
            self._take(name, decode(ObjectPose, payload), now, wall)
        except ZarmError as error:
            self._refusal.refused(error.problem, now)
        else:
            self._refusal.taken(now)
        self._changed()

    def of(self, scene: SceneSnapshot) -> tuple[Mover, ...]:
        """The moving objects of this scene. An object edited after its last pose stays where the edit has put it."""
        with self._lock:
            if scene is not self._scene:
                self._scene = scene
                self._movers = {
                    name: mover for name, mover in self._movers.items() if scene.objects.get(name) == mover.item
                }
                self._all = tuple(self._movers.values())
            return self._all

    def lost(self, now: float) -> tuple[str, ...]:
        """The names of the lost objects at `now` (s, monotonic)."""
        with self._lock:
            return tuple(name for name, mover in self._movers.items() if now - mover.seen > LOST)

    def _take(self, name: str, message: ObjectPose, now: float, wall: float) -> None:
        late = wall - message.stamp
        if late < -AGREE:
            raise InvalidRequest(
                f"the pose of {name} is stamped {-late:.3f} s in the future; make the clocks of both machines agree within {AGREE:g} s",
                field="stamp",
            )
        if late > LOST:
            raise InvalidRequest(
                f"the pose of {name} is {late:.3f} s old (at most {LOST:g} s); find out what delays it, and whether the clocks agree",
                field="stamp",
            )
        _refuse_what_cannot_be(name, message)
        item = self._monitor.snapshot(now).objects.get(name)
        if item is None:
            raise InvalidRequest(
                f"there is no object {name} in the scene; add it first, then publish its poses", field="name"
            )
        with self._lock:
            before = self._movers.get(name)
        if before is not None and before.item is item and message.stamp <= before.stamp:
            return
        placed, far = self._placed(item, message)
        turning = far * math.sqrt(sum(w * w for w in message.angular))
        mover = Mover(item, placed, message.linear, message.speed + turning, now - late - AGREE, message.stamp)
        with self._lock:
            self._movers[name] = mover
            self._all = tuple(self._movers.values())

    def _placed(self, item: SceneObject, message: ObjectPose) -> tuple[SceneObject, float]:
        """The object at the reported pose, and the greatest distance (m) of its points from its origin."""
        if isinstance(item, Voxels):
            raise InvalidRequest(
                f"{item.name} consists of voxels, which cannot move; add it as a primitive or a mesh", field="name"
            )
        if isinstance(item, Sphere):
            return item.model_copy(update={"position": message.position}), 0.0
        placed = item.model_copy(update={"position": message.position, "orientation": message.orientation})
        shapes = convex_shapes(placed, self._meshes)
        if len(shapes) > _SHAPES:
            raise InvalidRequest(
                f"{item.name} has {len(shapes)} triangles (at most {_SHAPES} can move); add a simpler mesh or a primitive",
                field="name",
            )
        lower, upper = packed_shapes.bounds(shapes)
        center = np.array(message.position)
        far = np.maximum(np.abs(lower - center), np.abs(upper - center)).max(axis=0)
        return placed, float(np.linalg.norm(far))


def _refuse_what_cannot_be(name: str, message: ObjectPose) -> None:
    for field, values, most in (
        ("position", message.position, _FARTHEST),
        ("linear", message.linear, _FASTEST),
        ("angular", message.angular, _FASTEST),
        ("speed", (message.speed,), _FASTEST),
    ):
        if max(map(abs, values)) > most:
            raise InvalidRequest(
                f"{max(map(abs, values)):g} for {name} is more than {most:g}; lengths are in m, speeds in m/s and rad/s",
                field=field,
            )
