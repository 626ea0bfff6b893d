"""From a goal to a verified motion: both ends, search, shorten, smooth, verify; and again where the last step refuses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from zarm_contract.errors import DeadlineExceeded, PlanningFailed
from zarm_contract.messages import Goal, PlanTimings, WaypointsGoal
from zarm_planner.ends import End, Snapshot, goal_ends, start_end
from zarm_planner.motion import Array, Limits, Motion
from zarm_planner.route import Route, find_route
from zarm_planner.smooth import smooth_path
from zarm_planner.stop import Stop
from zarm_planner.timing import time_path
from zarm_planner.verify import VerificationFailed, verify
from zarm_planner.watch import Watch
from zarm_planner.waypoints import passing_times

_DEVIATIONS = (0.03, 0.01, 0.0)
"""How far (rad) a motion may leave the path at corners where the smooth one is refused: ever closer to what is known free."""


@dataclass(frozen=True)
class Options:
    """What a request asks of the motion: its limits, after how many attempts to give up, and the seed of all chance."""

    limits: Limits
    max_attempts: int
    seed: int


@dataclass(frozen=True)
class Found:
    """A verified motion; `clearance` in m, `path_length` in rad, `waypoint_times` in s."""

    motion: Motion
    clearance: float
    path_length: float
    waypoint_times: tuple[float, ...]
    timings: PlanTimings


def plan(snapshot: Snapshot, start: Array, goal: Goal, options: Options, stop: Stop) -> Found:
    """The motion from `start` (dof,) to the goal.

    Raises PlanningFailed (`start_in_collision`, `goal_in_collision`, `unreachable`, `no_path`) and what `stop` raises.
    """
    watch = Watch()
    with watch.stage("ik"):
        begin = start_end(snapshot, start, options.seed, stop)
        targets = _targets(snapshot, start, goal, options.seed, stop)
    failure: VerificationFailed | None = None
    try:
        for attempt in range(options.max_attempts):
            seed = options.seed + attempt
            if (route := find_route(snapshot, begin, targets, seed, stop, watch)) is None:
                continue
            for timed in _motions(snapshot, route, options.limits, seed, stop):
                stop.check()
                with watch.stage("timing"):
                    motion = timed()
                try:
                    with watch.stage("verify"):
                        clearance = verify(
                            motion, start, route.ends[-1].asked, options.limits, snapshot.exact, stop.check
                        )
                        times = _waypoint_times(snapshot, motion, route, goal)
                except VerificationFailed as error:
                    failure = error
                    continue
                return Found(motion, clearance, motion.length, times, watch.timings())
    except DeadlineExceeded as late:
        if failure is None:
            raise
        raise _given_up(failure) from late
    if failure is not None:
        raise _given_up(failure)
    raise PlanningFailed(
        f"no path was found in {options.max_attempts} attempts; allow more with max_attempts, or simplify the scene",
        code="no_path",
    )


def _given_up(failure: VerificationFailed) -> PlanningFailed:
    return PlanningFailed(
        f"every path that was found had to be given up: {failure}; ask for a larger margin or more time", code="no_path"
    )


def _targets(snapshot: Snapshot, start: Array, goal: Goal, seed: int, stop: Stop) -> list[list[End]]:
    """The ends of each target in turn; those nearest to where the one before may be reached stand first."""
    if not isinstance(goal, WaypointsGoal):
        return [goal_ends(snapshot, start, goal, "goal", seed, stop)]
    targets: list[list[End]] = []
    for number, waypoint in enumerate(goal.through):
        targets.append(goal_ends(snapshot, start, waypoint, f"goal.through.{number}", seed, stop))
        start = targets[-1][0].asked
    return targets


def _motions(snapshot: Snapshot, route: Route, limits: Limits, seed: int, stop: Stop) -> Sequence[Callable[[], Motion]]:
    """Ways to time a route, the fastest first; those after it keep ever closer to its path."""
    model, path = snapshot.model, route.path
    dt = model.robot.descriptor.interpolation_dt
    return [
        partial(smooth_path, model, snapshot.world, path, limits, dt, seed=seed, stop=stop),
        *(partial(time_path, path, limits, dt, deviation) for deviation in _DEVIATIONS),
    ]


def _waypoint_times(snapshot: Snapshot, motion: Motion, route: Route, goal: Goal) -> tuple[float, ...]:
    """When the motion passes the waypoints of the goal. Raises VerificationFailed where it misses one."""
    if not isinstance(goal, WaypointsGoal):
        return ()
    configurations = [end.asked for end in route.ends]
    return passing_times(snapshot.model, motion, configurations, goal.position_tolerance, goal.angle_tolerance)
