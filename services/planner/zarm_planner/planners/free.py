"""Motions without a path constraint: RRT-Connect and shortcuts, smoothed in time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

from zarm_contract.errors import DeadlineExceeded
from zarm_planner.context import PlanningContext
from zarm_planner.deadline import Deadline
from zarm_planner.goals.problem import PlanningProblem
from zarm_planner.planners.base import NAMES, Faster, Planner
from zarm_planner.planners.route import Route, find_route
from zarm_planner.search.rrt_connect import search
from zarm_planner.search.shortcut import quickest_of, shortcut
from zarm_planner.timing.improvement import Improvement
from zarm_planner.timing.lead_in import LeadIn
from zarm_planner.timing.smoothing import brake_to_rest, smooth_path
from zarm_planner.timing.time_parameterization import joined, time_path
from zarm_trajectory.arrays import Array
from zarm_trajectory.trajectory import TimedTrajectory

Timed = Callable[[], TimedTrajectory]
"""Times a route."""

_SEARCHES = 10
"""Most searches for a path between two configurations, of which the quickest path counts."""
LEG_SAMPLES = 1000
"""Samples after which each of them gives up, a millisecond; nine of ten problems of MotionBenchMaker take fewer."""
_ALONE = 3
"""Factor on these samples for a leg without an alternative."""
_SAMPLES = 300_000
"""Samples after which the search to any of several configurations gives up: 0.1 s while its trees are small, and seconds
once they are large.
"""
_DEVIATIONS = (0.03, 0.01, 0.0)
"""How far (rad) a motion may leave the path at corners once the smooth one is refused: ever closer to what is known
free.
"""


class FreePlanner(Planner):
    """The quickest motion to a pose, to joints, or through waypoints."""

    names = {**NAMES, "groups": NAMES["pose"]}  # noqa: RUF012
    moving = True

    def trajectories(self, context: PlanningContext, problem: PlanningProblem) -> Iterator[TimedTrajectory]:
        """The smooth trajectory along the route, then those that round its corners less and less.

        From a start in motion the latter follow a stop.
        """
        if (route := _route(context, problem)) is None:
            return
        lead_in = problem.lead_in
        smooth: Timed = partial(_smooth, context, route, lead_in)
        others: list[Timed] = [partial(_along, context, route, deviation) for deviation in _DEVIATIONS]
        if lead_in is not None:
            others.insert(0, partial(_smooth, context, route, None))
            others = [partial(_after_rest, context, lead_in, timed) for timed in others]
        for timed in (smooth, *others):
            context.deadline.check()
            with context.timer.stage("timing"):
                trajectory = timed()
            yield trajectory

    def faster(self, context: PlanningContext, problem: PlanningProblem) -> Faster:
        """Other routes, and more shortcuts in time on the best trajectories so far."""

        def routes(number: int) -> tuple[Array, Sequence[int]] | None:
            try:
                route = _route(context.with_seed(context.seed + 1 + number), problem)
            except DeadlineExceeded:
                return None
            return None if route is None else (route.path, route.vias)

        improvement = Improvement(
            context.model, context.world, context.limits, context.dt, routes, context.seed, lead_in=problem.lead_in
        )
        return lambda duration: improvement.faster_than(duration, context.deadline)


def _route(context: PlanningContext, problem: PlanningProblem) -> Route | None:
    return find_route(_FreePaths(context), problem, context)


def _smooth(context: PlanningContext, route: Route, lead_in: LeadIn | None) -> TimedTrajectory:
    seed, deadline = context.seed, context.deadline
    return smooth_path(
        context.model,
        context.world,
        route.path,
        context.limits,
        context.dt,
        seed=seed,
        deadline=deadline,
        vias=route.vias,
        lead_in=lead_in,
    )


def _after_rest(context: PlanningContext, lead_in: LeadIn, timed: Timed) -> TimedTrajectory:
    return joined((brake_to_rest(context.model, context.world, lead_in, context.limits, context.dt), timed()))


def _along(context: PlanningContext, route: Route, deviation: float) -> TimedTrajectory:
    return time_path(route.path, context.limits, context.dt, deviation)


@dataclass(frozen=True)
class _FreePaths:
    """Paths that only have to be free of collision."""

    context: PlanningContext

    def between(self, start: Array, goal: Array, within: float, *, alone: bool) -> Array | None:
        """The quickest of a few paths; of more if they differ."""
        context = self.context
        seeds = range(_SEARCHES * context.seed, _SEARCHES * (context.seed + 1))
        found = quickest_of(
            context.model,
            context.world,
            start,
            goal,
            context.limits.velocity,
            within,
            seeds=seeds,
            deadline=context.deadline,
            most=LEG_SAMPLES * (_ALONE if alone else 1),
        )
        context.timer.add("search", found.search)
        context.timer.add("shortcut", found.shortcut)
        context.deadline.check()
        return found.path

    def to_any(self, start: Array, goals: Array, until: Deadline) -> Array | None:
        """The first path found, with shortcuts."""
        context = self.context
        model, world, seed, deadline = context.model, context.world, context.seed, context.deadline
        with context.timer.stage("search"):
            path = search(model, world, start, goals, seed=seed, deadline=until, most=_SAMPLES)
        deadline.check()
        if path is None:
            return None
        with context.timer.stage("shortcut"):
            return shortcut(model, world, path, seed=seed, deadline=deadline)
