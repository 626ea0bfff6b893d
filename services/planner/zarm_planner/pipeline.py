"""From a goal to a verified motion: both ends, search, shorten, smooth, verify; and again where the last step refuses."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from zarm_contract.errors import DeadlineExceeded, InvalidRequest, PlanningFailed
from zarm_contract.messages import Goal, HeldAxes, JointGoal, PlanTimings, PoseGoal, WaypointsGoal
from zarm_geometry.robot_model import RobotModel
from zarm_planner.ends import End, Snapshot, goal_ends, start_end
from zarm_planner.held import Held
from zarm_planner.held_motion import time_held
from zarm_planner.improve import GAIN, Improvement, Routes
from zarm_planner.motion import Array, Limits, Motion
from zarm_planner.paths import FreePaths, HeldPaths, Paths
from zarm_planner.route import Route, find_route
from zarm_planner.smooth import least_duration, smooth_path
from zarm_planner.stop import Stop
from zarm_planner.timing import time_path
from zarm_planner.verify import VerificationFailed, verify
from zarm_planner.watch import Watch
from zarm_planner.waypoints import passing_times

_DEVIATIONS = (0.03, 0.01, 0.0)
"""How far (rad) a motion may leave the path at corners where the smooth one is refused: ever closer to what is known free."""

_FASTEST_ONLY = 2
"""Attempts in which a motion that is refused gives way to another route, before other ways to time one are tried."""


@dataclass(frozen=True)
class Options:
    """What a request asks of the motion: its limits, what it holds of the tip's pose, after how many attempts to give up, for how many seconds to look for
    faster ones, and the seed of all chance.
    """

    limits: Limits
    held: HeldAxes | None
    max_attempts: int
    optimize_s: float
    seed: int


@dataclass(frozen=True)
class Verified:
    """A motion that may be executed; `clearance` in m, `waypoint_times` in s."""

    motion: Motion
    clearance: float
    waypoint_times: tuple[float, ...]


def plan(snapshot: Snapshot, start: Array, goal: Goal, options: Options, stop: Stop) -> tuple[Verified, PlanTimings]:
    """The motion from `start` (dof,) to the goal, and where the time went.

    Raises PlanningFailed (`start_in_collision`, `goal_in_collision`, `unreachable`, `no_path`) and what `stop` raises.
    """
    watch = Watch()
    with watch.stage("ik"):
        held = None
        if options.held is not None and any(options.held.axes):
            held = Held.of(snapshot.model, options.held, snapshot.model.fk_tip(start))
        begin = start_end(snapshot, start, held, options.seed, stop)
        targets = _targets(snapshot, start, goal, held, options.seed, stop)
    task = _Task(snapshot, begin, targets, goal, options.limits, held)
    verified, seed = _first(task, options, stop, watch)
    if options.optimize_s > 0.0:
        with watch.stage("optimize"):
            verified = _fastest(task, verified, seed, stop.sooner(options.optimize_s))
        if stop.cancelled:
            stop.check()
    return verified, watch.timings()


def _first(task: _Task, options: Options, stop: Stop, watch: Watch) -> tuple[Verified, int]:
    """The first motion that passes verification, and its seed."""
    failure: VerificationFailed | None = None
    try:
        for attempt in range(options.max_attempts):
            seed = options.seed + attempt
            if (route := task.route(seed, stop, watch)) is None:
                continue
            last = attempt >= min(_FASTEST_ONLY, options.max_attempts - 1)
            for timed in task.motions(route, seed, stop)[: None if last else 1]:
                stop.check()
                with watch.stage("timing"):
                    motion = timed()
                if motion is None:
                    continue
                try:
                    with watch.stage("verify"):
                        return task.verified(motion, stop), seed
                except VerificationFailed as error:
                    failure = error
    except DeadlineExceeded as late:
        if failure is None:
            raise
        raise _given_up(failure) from late
    if failure is not None:
        raise _given_up(failure)
    raise PlanningFailed(
        f"no path was found within max_attempts, {options.max_attempts}; allow more, or simplify the scene",
        code="no_path",
    )


def _fastest(task: _Task, best: Verified, seed: int, budget: Stop) -> Verified:
    """The fastest among `best` and the motions found until `budget` is spent; further seeds lead to other routes."""

    def routes(number: int) -> tuple[Array, Sequence[int]] | None:
        try:
            route = task.route(seed + 1 + number, budget, Watch())
        except DeadlineExceeded:
            return None
        return None if route is None else (route.path, route.rows[:-1])

    goals = np.array([end.asked for end in task.targets[-1]])
    least = least_duration(task.begin.asked, goals, task.limits, task.dt)
    faster_than = task.improvement(routes, seed)
    while best.motion.duration > (1.0 + GAIN) * least:
        try:
            if (motion := faster_than(best.motion.duration, budget)) is None:
                break
            best = task.verified(motion, budget)
        except VerificationFailed:
            continue
        except (DeadlineExceeded, InvalidRequest):  # the second where a motion along a detour fits no message
            break
    return best


def _given_up(failure: VerificationFailed) -> PlanningFailed:
    return PlanningFailed(
        f"every path that was found had to be given up: {failure}; ask for a larger margin or more time", code="no_path"
    )


def _targets(snapshot: Snapshot, start: Array, goal: Goal, held: Held | None, seed: int, stop: Stop) -> list[list[End]]:
    """The ends of each target in turn; those nearest to where the one before may be reached stand first."""
    through: dict[str, PoseGoal | JointGoal]
    if isinstance(goal, WaypointsGoal):
        through = {f"goal.through.{number}": waypoint for number, waypoint in enumerate(goal.through)}
    else:
        through = {"goal": goal}
    targets: list[list[End]] = []
    for field, target in through.items():
        targets.append(goal_ends(snapshot, start, target, field, held, seed, stop))
        start = targets[-1][0].asked
        if held is not None:
            held.check_goal(snapshot.model.fk_tip(start), field)
    return targets


@dataclass(frozen=True)
class _Task:
    """What is planned: from where, to what, under which limits."""

    snapshot: Snapshot
    begin: End
    targets: list[list[End]]
    goal: Goal
    limits: Limits
    held: Held | None

    @property
    def model(self) -> RobotModel:
        """The robot as it is in the scene."""
        return self.snapshot.model

    @property
    def dt(self) -> float:
        """The sample period (s) of motions."""
        return self.model.robot.descriptor.interpolation_dt

    def free(self, q: Array) -> bool:
        """Whether configurations (n, dof) touch nothing, exactly."""
        return self.snapshot.exact.nearest(q).distance > 0.0

    def route(self, seed: int, stop: Stop, watch: Watch) -> Route | None:
        """The route that a seed leads to."""
        paths: Paths = FreePaths(self.model, self.snapshot.world, seed, stop, watch)
        if self.held is not None:
            paths = HeldPaths(self.held, self.snapshot.world, seed, stop, watch)
        return find_route(paths, self.begin, self.targets, self.model.velocity)

    def motions(self, route: Route, seed: int, stop: Stop) -> Sequence[Callable[[], Motion | None]]:
        """Ways to time a route, the fastest first; those after it keep ever closer to its path."""
        world, path, limits, dt = self.snapshot.world, route.path, self.limits, self.dt
        if self.held is not None:
            return [partial(time_held, self.held, path, limits, dt, free=self.free, stop=stop, vias=route.rows[:-1])]
        return [
            partial(smooth_path, self.model, world, path, limits, dt, vias=route.rows[:-1], seed=seed, stop=stop),
            *(partial(time_path, path, limits, dt, deviation) for deviation in _DEVIATIONS),
        ]

    def improvement(self, routes: Routes, seed: int) -> Callable[[float, Stop], Motion | None]:
        """What finds a motion that is faster than so many seconds until it is stopped, along one of `routes`."""
        world, held, limits, dt = self.snapshot.world, self.held, self.limits, self.dt
        if held is None:
            return Improvement(self.model, world, limits, dt, routes, seed).faster_than
        numbers = itertools.count()

        def faster_than(duration: float, stop: Stop) -> Motion | None:
            while not stop.passed:
                if (route := routes(next(numbers))) is None:
                    continue
                motion = time_held(held, route[0], limits, dt, free=self.free, stop=stop, vias=route[1])
                if motion is not None and motion.duration <= (1.0 - GAIN) * duration:
                    return motion
            return None

        return faster_than

    def verified(self, motion: Motion, stop: Stop) -> Verified:
        """The motion with its clearance. Raises VerificationFailed and what `stop` raises."""
        asked = np.array([end.asked for end in self.targets[-1]])
        end = asked[np.argmin(np.abs(asked - motion.position[-1]).max(axis=1))]
        clearance = verify(motion, self.begin.asked, end, self.limits, self.snapshot.exact, stop.check, self.held)
        if not isinstance(self.goal, WaypointsGoal):
            return Verified(motion, clearance, ())
        waypoints = [ends[0].asked for ends in self.targets]  # all ends of one lead to the same pose of the tip
        tolerances = self.goal.position_tolerance, self.goal.angle_tolerance
        return Verified(motion, clearance, passing_times(self.model, motion, waypoints, *tolerances))
