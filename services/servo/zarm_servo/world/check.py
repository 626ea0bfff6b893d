"""Checks how far a trajectory is free in a scene: the path time up to which the robot may go, and the obstacle after
it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from zarm_contract.messages import Obstruction, SceneObject, Touch
from zarm_geometry.meshes import Meshes
from zarm_geometry.motion_check import MotionCheck
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.situation import MotionVerdict, MovingObject
from zarm_geometry.world import World
from zarm_servo.world.moving_objects import Mover
from zarm_servo.world.scene_monitor import SceneSnapshot
from zarm_trajectory.arrays import Array
from zarm_trajectory.trajectory import TimedTrajectory

CONTACT = 0.002
"""Anything closer than this (m) counts as a contact; the robot may deviate from its trajectory by as much."""
DISTANCE = 0.02
"""The robot stops this far (m) from an obstacle if it can."""
_SAMPLE = 0.01
"""Interval (s) at which the trajectory is sampled."""
LOOK_AHEAD = 3.0
"""Look-ahead (s of path time) when checking against moving objects."""
_FINENESS = 0.02
"""The sweep of a moving object is approximated by copies of it at most twice this (m) apart."""
_GRAIN = 0.02
"""An authority that ends before a moving object is rounded to a multiple of this (s), so that it does not change with
every pose.
"""
_UPDATES = 100
"""After this many object updates, building a new world is faster than keeping the changes beside the old one."""


@dataclass(frozen=True)
class PathValidity:
    """The robot may go up to the path time `until` (s), or to the end if None. `obstruction` is what lies after it."""

    until: float | None = None
    obstruction: Obstruction | None = None


class SceneCheck:
    """A motion check, `motions`, whose world follows the scene. One `load` at a time."""

    def __init__(self, model: RobotModel, meshes: Meshes) -> None:
        self.model, self._meshes = model, meshes
        self.motions = MotionCheck(model, meshes)
        self._objects: Mapping[str, SceneObject] = {}
        self._world: World | None = None  # the last whole one; the next reuses its unchanged parts
        self._updates = 0

    def load(self, objects: Mapping[str, SceneObject], without: Collection[str] = ()) -> None:
        """Make these objects, minus those named in `without`, the whole world. Raises Unavailable if a mesh cannot be
        read.
        """
        objects = {name: item for name, item in objects.items() if name not in without} if without else objects
        known = self._objects
        changed = [item for name, item in objects.items() if known.get(name) is not item and known.get(name) != item]
        removed = [name for name in self._objects if name not in objects]
        self._updates += len(changed) + len(removed)
        if self._updates > _UPDATES:
            self._world = World(list(objects.values()), 0.0, self._meshes, self._world)
            self.motions.set_world(self._world)
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
        touches: Sequence[Touch] = (),
    ) -> PathValidity:
        """How far `trajectory` is free in the scene, from the path time `begin` (s) on, ignoring the objects in
        `without`, and those of `touches` in their times.

        The whole trajectory was checked in the scene `verified`, so only what has changed since is checked: not the
        other objects, nor the robot's own links, which may pass close to each other. The robot brakes along the
        trajectory, so its braking is free wherever the trajectory is. Raises Unavailable if a mesh cannot be read.
        """
        same = verified is not None and _robot_in(verified) == _robot_in(scene)
        before = verified.objects if same and verified is not None else {}
        objects = {
            name: item for name, item in scene.objects.items() if before.get(name) != item and name not in without
        }
        if (same and not objects) or begin >= trajectory.duration:
            return PathValidity()
        for first, last, ignored in _parts(begin, trajectory.duration, touches):
            part = {name: item for name, item in objects.items() if name not in ignored} if ignored else objects
            found = self._validity_between(trajectory, first, last, scene, part, self_collision=not same)
            if found.until is not None:
                return found
        return PathValidity()

    def _validity_between(
        self,
        trajectory: TimedTrajectory,
        begin: float,
        end: float,
        scene: SceneSnapshot,
        objects: Mapping[str, SceneObject],
        *,
        self_collision: bool,
    ) -> PathValidity:
        """How far a trajectory is free of `objects` between two path times (s)."""
        self._scene.load(objects)
        times = _times(begin, end)
        positions = trajectory.positions(times)

        def first(*grown: MovingObject) -> MotionVerdict:
            situation = self._scene.motions.situation(
                scene.attached, scene.ignored_links, grown, scene.openings, scene.ignored_pairs
            )
            return situation.check(times, positions, margin=CONTACT, self_collision=self_collision)

        contact = first()
        time, what = contact.contact_time, contact.object or ""
        if time is None:
            return PathValidity()
        until = time
        if what in objects:  # keep the distance to this object only: others may be closer to the trajectory all along
            until = first(MovingObject(objects[what], growth=DISTANCE)).contact_time or time
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
        """How far `trajectory` is free of moving objects, from the path time `begin` (s) on.

        A point counts as free if no object can be there at `now` (s, monotonic) or in the following `stopping` s, in
        which the robot comes to rest. Only the first AHEAD s are checked. The obstruction's time is that of the contact
        with the object at its current place, or the end of the trajectory. Raises Unavailable if a mesh cannot be read.
        """
        if begin >= trajectory.duration:
            return PathValidity()
        times = _times(begin, min(begin + LOOK_AHEAD, trajectory.duration))
        positions = trajectory.positions(times)

        def first(places: Sequence[MovingObject]) -> MotionVerdict:
            situation = self._moving.situation(
                scene.attached, scene.ignored_links, places, scene.openings, scene.ignored_pairs
            )
            return situation.check(times, positions, margin=CONTACT, self_collision=False)

        found = first([place for mover in movers for place in mover.swept(now, stopping, _FINENESS)])
        until, name = found.contact_time, found.object
        if until is None or name is None:
            return PathValidity()
        until = max(begin, _GRAIN * math.floor(until / _GRAIN))
        mover = next(mover for mover in movers if mover.item.name == name)
        present = first(mover.swept(now, 0.0, _FINENESS)).contact_time
        time = trajectory.duration if present is None else present
        return PathValidity(until, Obstruction(object=name, link=found.link or "", time=max(time, until)))


def _robot_in(scene: SceneSnapshot) -> tuple[object, ...]:
    """What decides how the robot is checked in a scene."""
    return scene.attached, scene.ignored_links, scene.ignored_pairs, scene.openings


def _parts(begin: float, end: float, touches: Sequence[Touch]) -> Iterator[tuple[float, float, frozenset[str]]]:
    """The parts between two path times (s) in which the same objects may be touched: when each begins and ends, and which."""
    edges = {begin, end, *(edge for touch in touches for edge in (touch.begin, touch.end) if begin < edge < end)}
    for first, last in itertools.pairwise(sorted(edges)):
        middle = (first + last) / 2.0
        yield (
            first,
            last,
            frozenset(name for touch in touches if touch.begin <= middle <= touch.end for name in touch.objects),
        )


def _times(begin: float, end: float) -> Array:
    """The sample times (N,) in s of a trajectory."""
    times = np.append(np.arange(begin, end, _SAMPLE), end)
    return np.asarray(times[np.append(np.diff(times) > 1e-6, True)])
