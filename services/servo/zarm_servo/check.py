"""How far a trajectory is free in a scene: the path time up to which the robot may go, and the obstacle after it."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from zarm_contract.messages import Obstruction, SceneObject
from zarm_geometry.meshes import Meshes
from zarm_geometry.motion_check import MotionCheck, MotionVerdict, MovingObject
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_servo.moving_objects import Mover
from zarm_servo.scene_monitor import SceneSnapshot
from zarm_trajectory.quintic import Array
from zarm_trajectory.trajectory import TimedTrajectory

CONTACT = 0.002
"""What comes closer than this (m) counts as a contact: what a robot may be beside its trajectory."""
DISTANCE = 0.02
"""The robot rests so far (m) from what is in its way, where it can."""
_SAMPLE = 0.01
"""The trajectory is looked at this often (s)."""
_LONG = 1e3
"""An object that may have moved for so long (s) at a small speed is larger on all sides."""
AHEAD = 3.0
"""So far (s of the path) ahead of the robot it is looked for what moves."""
_FINENESS = 0.02
"""What moves on a straight line is looked at as objects up to twice this (m) apart."""
_GRAIN = 0.02
"""An authority before what moves ends at a multiple of this (s), so that it does not change with every pose."""
_UPDATES = 100
"""After so many changed objects a new world is quicker than to keep them beside the old one."""


@dataclass(frozen=True)
class PathValidity:
    """A robot may go up to the path time `until` (s); None: to the end. `obstruction` is what comes then."""

    until: float | None = None
    obstruction: Obstruction | None = None


class SceneCheck:
    """A check of motions, `motions`, in a world that is kept as the scene is. One `load` at a time."""

    def __init__(self, model: RobotModel, meshes: Meshes) -> None:
        self.model, self._meshes = model, meshes
        self.motions = MotionCheck(model, meshes)
        self._objects: Mapping[str, SceneObject] = {}
        self._updates = 0

    def load(self, objects: Mapping[str, SceneObject], without: Collection[str] = ()) -> None:
        """Have these objects in the world, by their names, less some of them, and no others. Raises Unavailable if a mesh cannot
        be read.
        """
        objects = {name: item for name, item in objects.items() if name not in without} if without else objects
        known = self._objects
        changed = [item for name, item in objects.items() if known.get(name) is not item and known.get(name) != item]
        removed = [name for name in self._objects if name not in objects]
        self._updates += len(changed) + len(removed)
        if self._updates > _UPDATES:
            self.motions.set_world(World(list(objects.values()), 0.0, self._meshes))
            self._updates = 0
        elif changed or removed:
            self.motions.update(changed, removed)
        self._objects = dict(objects)


class Checker:
    """Checks trajectories of one robot. One call at a time."""

    def __init__(self, model: RobotModel, meshes: Meshes) -> None:
        self._scene = SceneCheck(model, meshes)
        self._moving = MotionCheck(model, meshes)

    def validity(
        self,
        trajectory: TimedTrajectory,
        begin: float,
        scene: SceneSnapshot,
        verified: SceneSnapshot | None,
        without: Collection[str] = (),
    ) -> PathValidity:
        """How far `trajectory` is free in the scene, from the path time `begin` (s) on, `without` some objects.

        In the scene `verified` it was checked as a whole, so what has not changed since then need not be looked at: other objects, and
        the robot's own links, which may pass one another closely. The robot brakes along the trajectory, so its braking is free where the trajectory is. Raises Unavailable if a mesh cannot be read.
        """
        same = verified is not None and (verified.attached, verified.ignored_links) == (
            scene.attached,
            scene.ignored_links,
        )
        before = verified.objects if same and verified is not None else {}
        objects = {
            name: item for name, item in scene.objects.items() if before.get(name) != item and name not in without
        }
        if (same and not objects) or begin >= trajectory.duration:
            return PathValidity()
        self._scene.load(objects)
        times = _times(begin, trajectory.duration)
        positions = trajectory.positions(times)

        def first(*grown: MovingObject) -> MotionVerdict:
            return self._scene.motions.check(
                times,
                positions,
                margin=CONTACT,
                attached=scene.attached,
                ignored_links=scene.ignored_links,
                moving=grown,
                self_collision=not same,
            )

        contact = first()
        time, what = contact.contact_time, contact.object or ""
        if time is None:
            return PathValidity()
        until = time
        if what in objects:  # the distance is kept to it alone: much else may be nearer to the trajectory all the time
            grown = MovingObject(objects[what], speed=DISTANCE / _LONG, time=begin - _LONG)
            until = first(grown).contact_time or time
        return PathValidity(until, Obstruction(object=what, link=contact.link or "", time=time))

    def validity_among(
        self,
        trajectory: TimedTrajectory,
        begin: float,
        scene: SceneSnapshot,
        movers: Sequence[Mover],
        now: float,
        stopping: float,
    ) -> PathValidity:
        """How far `trajectory` is free of what moves, from the path time `begin` (s) on.

        It is free where nothing can be at the moment `now` (s, monotonic) or in the `stopping` s after it, in which the robot comes
        to rest from there. The first AHEAD s are looked at. The obstruction's time is that of the contact with the object where it
        is now, or the end of the trajectory. Raises Unavailable if a mesh cannot be read.
        """
        if begin >= trajectory.duration:
            return PathValidity()
        times = _times(begin, min(begin + AHEAD, trajectory.duration))
        positions = trajectory.positions(times)

        def first(places: Sequence[tuple[SceneObject, float]]) -> MotionVerdict:
            return self._moving.check(
                times,
                positions,
                margin=CONTACT,
                attached=scene.attached,
                ignored_links=scene.ignored_links,
                moving=[MovingObject(item, speed=growth / _LONG, time=begin - _LONG) for item, growth in places],
                self_collision=False,
            )

        found = first([place for mover in movers for place in mover.swept(now, stopping, _FINENESS)])
        until, name = found.contact_time, found.object
        if until is None or name is None:
            return PathValidity()
        until = max(begin, _GRAIN * math.floor(until / _GRAIN))
        mover = next(mover for mover in movers if mover.item.name == name)
        present = first(mover.swept(now, 0.0, _FINENESS)).contact_time
        time = trajectory.duration if present is None else present
        return PathValidity(until, Obstruction(object=name, link=found.link or "", time=max(time, until)))


def _times(begin: float, end: float) -> Array:
    """The times (N,) s at which a trajectory is looked at."""
    times = np.append(np.arange(begin, end, _SAMPLE), end)
    return np.asarray(times[np.append(np.diff(times) > 1e-6, True)])
