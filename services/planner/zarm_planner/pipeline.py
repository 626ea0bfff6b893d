"""From a goal to a verified motion: both ends, search, shorten, smooth, verify; and again where the last step refuses."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from zarm_contract.errors import DeadlineExceeded, PlanningFailed
from zarm_contract.messages import Goal, PlanTimings
from zarm_planner.ends import Snapshot, goal_ends, start_end
from zarm_planner.motion import Array, Limits, Motion
from zarm_planner.search import search
from zarm_planner.shorten import shorten
from zarm_planner.smooth import smooth_path
from zarm_planner.stop import Stop
from zarm_planner.timing import time_path
from zarm_planner.verify import VerificationFailed, verify

_DEVIATIONS = (0.03, 0.01, 0.0)
"""How far (rad) a motion may leave the path at corners where the smooth one is refused: ever closer to what is known free."""

_NEAREST = 4
"""Goals that are tried one by one."""
_TRIES = 4
"""Paths to each, of which the shortest counts; on MotionBenchMaker's problems it is about a tenth shorter than one alone."""
_SAMPLES = 1000
"""Samples after which such a try is given up, some milliseconds; nine of ten problems of MotionBenchMaker take fewer."""


@dataclass(frozen=True)
class Found:
    """A verified motion; `clearance` in m, `path_length` in rad."""

    motion: Motion
    clearance: float
    path_length: float
    timings: PlanTimings


def plan(snapshot: Snapshot, start: Array, goal: Goal, limits: Limits, seed: int, stop: Stop) -> Found:
    """The motion from `start` (dof,) to the goal.

    Raises PlanningFailed (`start_in_collision`, `goal_in_collision`, `unreachable`, `no_path`) and what `stop` raises.
    """
    watch = _Watch()
    with watch.stage("ik"):
        begin = start_end(snapshot, start, seed, stop)
        ends = goal_ends(snapshot, start, goal, seed, stop)
    free = np.array([end.free for end in ends])
    failure: VerificationFailed | None = None
    attempt = seed
    try:
        while True:
            between = _shortest_path(snapshot, begin.free, free, attempt, stop, watch)
            end = ends[int(np.argmin(np.abs(free - between[-1]).max(axis=1)))]
            path = np.concatenate([begin.edge, between, end.edge])
            for timed in _motions(snapshot, path, limits, attempt, stop):
                stop.check()
                with watch.stage("timing"):
                    motion = timed()
                try:
                    with watch.stage("verify"):
                        clearance = verify(motion, start, end.asked, limits, snapshot.exact, stop.check)
                except VerificationFailed as error:
                    failure = error
                    continue
                return Found(motion, clearance, motion.length, watch.timings())
            attempt += 1
    except DeadlineExceeded as late:
        if failure is None:
            raise
        raise PlanningFailed(
            f"every path that was found had to be given up: {failure}; ask for a larger margin or more time",
            code="no_path",
        ) from late


def _shortest_path(snapshot: Snapshot, start: Array, goals: Array, seed: int, stop: Stop, watch: _Watch) -> Array:
    """A short free path (n, dof) from `start` (dof,) to one of `goals` (m, dof), the nearest of which stands first.

    A detour to a near goal can be shorter than the straight way to a far one, such as the same posture a turn away. So the
    nearest goals are tried one by one, as long as one can still be nearer than the best path so far is long; only where
    none of them is reached soon, any goal will do.
    """
    model, world, best, shortest = snapshot.model, snapshot.world, None, np.inf
    for goal in goals[:_NEAREST]:
        for attempt in range(_TRIES * seed, _TRIES * (seed + 1)):
            if np.linalg.norm(goal - start) >= shortest:
                break
            with watch.stage("search"):
                path = search(model, world, start, goal, seed=attempt, stop=stop, most=_SAMPLES)
            stop.check()
            if path is None:
                break
            with watch.stage("shorten"):
                path = shorten(model, world, path, seed=attempt, stop=stop)
            if (length := float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())) < shortest:
                best, shortest = path, length
    if best is not None:
        return best
    with watch.stage("search"):
        while (path := search(model, world, start, goals, seed=seed, stop=stop)) is None:
            stop.check()  # which is why it ended
    with watch.stage("shorten"):
        return shorten(model, world, path, seed=seed, stop=stop)


def _motions(snapshot: Snapshot, path: Array, limits: Limits, seed: int, stop: Stop) -> list[Callable[[], Motion]]:
    """Ways to time a path, the fastest first; those after it keep ever closer to the path."""
    model = snapshot.model
    dt = model.robot.descriptor.interpolation_dt
    return [
        partial(smooth_path, model, snapshot.world, path, limits, dt, seed=seed, stop=stop),
        *(partial(time_path, path, limits, dt, deviation) for deviation in _DEVIATIONS),
    ]


@dataclass
class _Watch:
    """Seconds per stage."""

    began: float = field(default_factory=time.perf_counter)
    spent: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        began = time.perf_counter()
        try:
            yield
        finally:
            self.spent[name] = self.spent.get(name, 0.0) + time.perf_counter() - began

    def timings(self) -> PlanTimings:
        stages = {
            name: self.spent.get(name, 0.0) for name in ("ik", "search", "shorten", "timing", "verify", "optimize")
        }
        return PlanTimings(**stages, total=time.perf_counter() - self.began)
