"""The two ends of a path: where the robot is and where it may go, and the nearest places from which the search can work.

Spheres are larger than the links that they cover. So a robot that holds its tool close to a table, and touches nothing,
seems to touch it; from there it first moves a little away, on a straight edge that exact geometry finds free.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zarm_contract.errors import PlanningFailed
from zarm_contract.messages import JointGoal, PoseGoal
from zarm_geometry.collision import is_free
from zarm_geometry.exact import RESOLUTION, Nearest
from zarm_geometry.frames import matrix
from zarm_planner.constraints.path_constraint import ConstraintManifold
from zarm_planner.context import PlanningContext
from zarm_planner.goals.joints import within_range
from zarm_planner.kinematics.ik import solve_ik

Array = NDArray[np.float64]

_GOALS = 16
"""At most so many ways to reach a pose are considered."""
_TRIES = 40
"""Directions tried at each distance to get away from an obstacle."""
_DISTANCES = (0.02, 0.05, 0.1, 0.2, 0.4, 0.8)
"""Rad, Euclidean."""


@dataclass(frozen=True)
class End:
    """A configuration that was asked for, and one for the search, free in spheres: itself where it is; (dof,) each."""

    asked: Array
    free: Array

    @property
    def edge(self) -> Array:
        """The way from the free one to the other: no row, or the one that was asked for."""
        return self.asked[None][: 0 if self.free is self.asked else 1]


def start_end(context: PlanningContext, q: Array, constraint: ConstraintManifold | None) -> End:
    """The start of a path. Raises PlanningFailed (`start_in_collision`)."""
    nearest = context.exact.nearest(q)
    if nearest.distance <= 0.0:
        raise PlanningFailed(
            f"the start is in collision: {_overlap(nearest)}; move the robot away by hand, or correct the scene",
            code="start_in_collision",
            field="start",
        )
    if (end := _end(context, q, constraint)) is None:
        raise PlanningFailed(
            f"there is no way out of the start, where {_gap(nearest)}; move the robot away by hand, or lower margin",
            code="start_in_collision",
            field="start",
        )
    return end


def goal_ends(
    context: PlanningContext,
    start: Array,
    goal: PoseGoal | JointGoal,
    field: str,
    constraint: ConstraintManifold | None,
) -> tuple[End, ...]:
    """The configurations that reach a goal, which is the request's `field`; the one nearest to `start` first.

    Raises PlanningFailed (`unreachable`, `goal_in_collision`), InvalidRequest for joints out of their range, and what
    the deadline raises.
    """
    model = context.model
    match goal:
        case JointGoal():
            candidates = np.array([within_range(model, goal.position, f"{field}.position")])
        case PoseGoal():
            pose = matrix(goal.position, goal.orientation)
            found = solve_ik(
                model,
                pose,
                start,
                world=context.world,
                max_solutions=_GOALS,
                seed=context.seed,
                deadline=context.deadline,
            )
            context.deadline.check()
            if len(found.solutions):
                return tuple(End(q, q) for q in found.solutions)
            candidates = found.colliding[:_GOALS]
            if not len(candidates):
                raise PlanningFailed(
                    f"the goal cannot be reached: the tip comes within {1e3 * found.distance:.1f} mm and "
                    f"{np.rad2deg(found.angle):.1f} deg of it at best; choose a pose nearer to the robot or another orientation",
                    code="unreachable",
                    field=field,
                )
    ends: list[End] = []
    obstacles = []
    for q in candidates:
        nearest = context.exact.nearest(q)
        if nearest.distance > 0.0 and (end := _end(context, q, constraint)):
            ends.append(end)
        else:
            obstacles.append(nearest)
    if not ends:
        nearest = max(obstacles, key=lambda nearest: nearest.distance)
        reason = f"in collision: {_overlap(nearest)}" if nearest.distance <= 0.0 else f"out of reach: {_gap(nearest)}"
        ways = f" in all {len(candidates)} ways to reach it" if len(candidates) > 1 else ""
        raise PlanningFailed(
            f"the goal is{ways} {reason}; choose another one, lower margin, or correct the scene",
            code="goal_in_collision",
            field=field,
        )
    return tuple(ends)


def _end(context: PlanningContext, q: Array, constraint: ConstraintManifold | None) -> End | None:
    """The end at `q`, which is free of collision; None where no way that keeps the constraint leads to what is free in spheres."""
    if is_free(context.model, context.world, q):
        return End(q, q)
    model, random = context.model, np.random.default_rng(context.seed)
    for distance in _DISTANCES:
        for direction in random.normal(size=(_TRIES, model.dof)):
            context.deadline.check()
            near = np.clip(q + distance * direction / np.linalg.norm(direction), model.lower, model.upper)
            if constraint is not None:
                if (kept := constraint.projected(near)) is None:
                    continue
                near = kept[0]
            if is_free(model, context.world, near):
                steps = int(np.abs(near - q) @ context.exact.reach / RESOLUTION) + 2
                way = np.linspace(q, near, steps)
                if (constraint is None or constraint.use(way).max() <= 1.0) and context.exact.nearest(
                    way
                ).distance > 0.0:
                    return End(q, near)
    return None


def _overlap(nearest: Nearest) -> str:
    a, b = nearest.pair or ("", "")
    return f"{a} is {-1e3 * nearest.distance:.1f} mm inside {b}"


def _gap(nearest: Nearest) -> str:
    a, b = nearest.pair or ("", "")
    return f"{a} is only {1e3 * nearest.distance:.1f} mm from {b}"
