"""Motions that keep a path constraint: CBiRRT and shortcuts on its manifold, along a smooth curve timed by reachability analysis."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from zarm_contract.errors import DeadlineExceeded, InvalidRequest
from zarm_planner.constraints.constrained_search import search_constrained, shortcut_constrained
from zarm_planner.constraints.constrained_timing import time_constrained
from zarm_planner.constraints.path_constraint import ConstraintManifold
from zarm_planner.context import PlanningContext
from zarm_planner.deadline import Deadline
from zarm_planner.goals.problem import PlanningProblem
from zarm_planner.planners.base import NAMES, Faster, Planner
from zarm_planner.planners.route import Route, find_route
from zarm_planner.timing.improvement import GAIN
from zarm_trajectory.arrays import Array
from zarm_trajectory.trajectory import TimedTrajectory

_LEG_SAMPLES = 1000
"""Samples after which the search between two configurations gives up."""
_SAMPLES = 10_000
"""Samples after which the search to any of several configurations gives up: 0.3 s with one arm, 1 s with two."""


class ConstrainedPlanner(Planner):
    """To a pose, to joints, through waypoints, or with several groups, under a path constraint."""

    names = {**NAMES, "groups": NAMES["pose"]}  # noqa: RUF012
    constrained = True

    def trajectories(self, context: PlanningContext, problem: PlanningProblem) -> Iterator[TimedTrajectory]:
        """The trajectory along the route; there is no other that keeps the constraint."""
        constraint = _constraint(problem)
        if (route := _route(context, problem, constraint)) is None:
            return
        with context.timer.stage("timing"):
            context.deadline.check()
            trajectory = _timed(context, constraint, route)
        if trajectory is not None:
            yield trajectory

    def faster(self, context: PlanningContext, problem: PlanningProblem) -> Faster:
        """Trajectories along other routes."""
        constraint, seeds = _constraint(problem), itertools.count(context.seed + 1)

        def faster_than(duration: float) -> TimedTrajectory | None:
            while not context.deadline.passed:
                try:
                    route = _route(context.with_seed(next(seeds)), problem, constraint)
                except DeadlineExceeded:
                    return None
                if route is None:
                    continue
                trajectory = _timed(context, constraint, route)
                if trajectory is not None and trajectory.duration <= (1.0 - GAIN) * duration:
                    return trajectory
            return None

        return faster_than


def _constraint(problem: PlanningProblem) -> ConstraintManifold:
    if problem.constraint is None:
        raise InvalidRequest("there is no path constraint to keep; say which axes to hold", field="path_constraint")
    return problem.constraint


def _route(context: PlanningContext, problem: PlanningProblem, constraint: ConstraintManifold) -> Route | None:
    return find_route(_ConstrainedPaths(context, constraint), problem, context)


def _timed(context: PlanningContext, constraint: ConstraintManifold, route: Route) -> TimedTrajectory | None:
    def free(q: Array) -> bool:
        return context.exact.is_free(q, context.deadline.check)

    return time_constrained(
        constraint, route.path, context.limits, context.dt, free=free, deadline=context.deadline, vias=route.vias
    )


@dataclass(frozen=True)
class _ConstrainedPaths:
    """Paths that keep a path constraint."""

    context: PlanningContext
    constraint: ConstraintManifold

    def between(self, start: Array, goal: Array, within: float, *, alone: bool) -> Array | None:
        """A path found quickly, with shortcuts."""
        return self._path(start, goal[None], self.context.deadline, _LEG_SAMPLES)

    def to_any(self, start: Array, goals: Array, until: Deadline) -> Array | None:
        """The first path found, with shortcuts."""
        return self._path(start, goals, until, _SAMPLES)

    def _path(self, start: Array, goals: Array, until: Deadline, most: int) -> Array | None:
        if np.array_equal(start, goals[0]):
            return goals[:1]
        context, constraint = self.context, self.constraint
        world, seed, deadline = context.world, context.seed, context.deadline
        with context.timer.stage("search"):
            path = search_constrained(world, constraint, start, goals, seed=seed, deadline=until, most=most)
        deadline.check()
        if path is None:
            return None
        with context.timer.stage("shortcut"):
            return shortcut_constrained(world, constraint, path, seed=seed, deadline=deadline)
