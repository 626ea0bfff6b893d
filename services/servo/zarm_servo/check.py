"""How far a trajectory is free in a scene: up to which path time a robot may go, and what is in the way there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from zarm_contract.messages import Obstruction, SceneObject
from zarm_geometry.meshes import Meshes
from zarm_geometry.motion_check import MotionCheck, MotionVerdict, MovingObject
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_servo.scene_monitor import SceneSnapshot
from zarm_trajectory.trajectory import TimedTrajectory

CONTACT = 0.002
"""What comes closer than this (m) counts as a contact: what a robot may be beside its trajectory."""
DISTANCE = 0.02
"""The robot rests so far (m) from what is in its way, where it can."""
_SAMPLE = 0.01
"""The trajectory is looked at this often (s)."""
_LONG = 1e3
"""An object that may have moved for so long (s) at a small speed is larger on all sides."""
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

    def load(self, objects: Mapping[str, SceneObject]) -> None:
        """Have these objects in the world, by their names, and no others. Raises Unavailable where a mesh cannot be read."""
        changed = [item for name, item in objects.items() if self._objects.get(name) != item]
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

    def validity(
        self, trajectory: TimedTrajectory, begin: float, scene: SceneSnapshot, verified: SceneSnapshot | None
    ) -> PathValidity:
        """How far `trajectory` is free in the scene, from the path time `begin` (s) on.

        In the scene `verified` it was checked as a whole, so what has not changed since then need not be looked at: other objects, and
        the robot's own links, which may pass one another closely. The robot brakes along the trajectory, so its braking is free where the trajectory is. Raises Unavailable where a mesh cannot be read.
        """
        same = verified is not None and (verified.attached, verified.ignored_links) == (
            scene.attached,
            scene.ignored_links,
        )
        before = verified.objects if same and verified is not None else {}
        objects = {name: item for name, item in scene.objects.items() if before.get(name) != item}
        if (same and not objects) or begin >= trajectory.duration:
            return PathValidity()
        self._scene.load(objects)
        times = np.append(np.arange(begin, trajectory.duration, _SAMPLE), trajectory.duration)
        times = times[np.append(np.diff(times) > 1e-6, True)]
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
