"""Free paths between configurations: what a route is put together of, whatever the path has to keep."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.held import Held
from zarm_planner.held_motion import search_held, shorten_held
from zarm_planner.motion import Array
from zarm_planner.search import search
from zarm_planner.shorten import quickest_of, shorten
from zarm_planner.stop import Stop
from zarm_planner.watch import Watch

_TRIES = 4
"""Paths between two, of which the quickest counts; on MotionBenchMaker's problems it is about a tenth shorter than one alone."""
_SAMPLES = 1000
"""Samples after which such a try is given up, some milliseconds; nine of ten problems of MotionBenchMaker take fewer."""
_MOST_SAMPLES = 100_000
"""Samples after which a search to any of several configurations is given up, some seconds."""


class Paths(Protocol):
    """Paths (n, dof) whose straight edges are free in spheres. The same seed gives the same paths; `stop` may raise."""

    def between(self, start: Array, goal: Array) -> Array | None:
        """A short path between two configurations (dof,); None where none was found soon."""

    def to_any(self, start: Array, goals: Array) -> Array | None:
        """A path to one of `goals` (m, dof); None where none was found with much patience."""


@dataclass
class FreePaths:
    """Paths that have to keep nothing but free."""

    model: RobotModel
    world: World
    seed: int
    stop: Stop
    watch: Watch

    def between(self, start: Array, goal: Array) -> Array | None:
        """The quickest of a few."""
        seeds = range(_TRIES * self.seed, _TRIES * (self.seed + 1))
        found = quickest_of(self.model, self.world, start, goal, seeds=seeds, stop=self.stop, most=_SAMPLES)
        self.watch.add("search", found.search)
        self.watch.add("shorten", found.shorten)
        self.stop.check()
        return found.path

    def to_any(self, start: Array, goals: Array) -> Array | None:
        """The first that is found, shortened."""
        with self.watch.stage("search"):
            path = search(self.model, self.world, start, goals, seed=self.seed, stop=self.stop, most=_MOST_SAMPLES)
        self.stop.check()
        if path is None:
            return None
        with self.watch.stage("shorten"):
            return shorten(self.model, self.world, path, seed=self.seed, stop=self.stop)


@dataclass
class HeldPaths:
    """Paths that keep what is held of the tip's pose."""

    held: Held
    world: World
    seed: int
    stop: Stop
    watch: Watch

    def between(self, start: Array, goal: Array) -> Array | None:
        """The first that is found soon, shortened."""
        return self._path(start, goal[None], _SAMPLES)

    def to_any(self, start: Array, goals: Array) -> Array | None:
        """The first that is found, shortened."""
        return self._path(start, goals, _MOST_SAMPLES)

    def _path(self, start: Array, goals: Array, most: int) -> Array | None:
        if np.array_equal(start, goals[0]):
            return goals[:1]
        with self.watch.stage("search"):
            path = search_held(self.world, self.held, start, goals, seed=self.seed, stop=self.stop, most=most)
        self.stop.check()
        if path is None:
            return None
        with self.watch.stage("shorten"):
            return shorten_held(self.world, self.held, path, seed=self.seed, stop=self.stop)
