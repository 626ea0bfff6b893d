"""The two ends of a path: where the robot is and where it may go, and the nearest places from which the search can work.

Spheres are larger than the links that they cover. So a robot that holds its tool close to a table, and touches nothing,
seems to touch it; from there it first moves a little away, on a straight edge that exact geometry finds free.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from zarm_contract.errors import InvalidRequest, PlanningFailed, ZarmError
from zarm_contract.messages import JointGoal, Pose, PoseGoal
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
_SET_GOALS = 256
"""And so many to reach any pose of a goal set, the same number of each."""
_TRIES = 40
"""Directions tried at each distance to get away from an obstacle."""
_DISTANCES = (0.02, 0.05, 0.1, 0.2, 0.4, 0.8)
"""Rad, Euclidean."""


@dataclass(frozen=True)
class End:
    """A configuration that was asked for, and one for the search, free in spheres: itself where it is; (dof,) each.

    `pose` says which of a goal's poses it reaches, where it has any.
    """

    asked: Array
    free: Array
    pose: int | None = None

    @property
    def edge(self) -> Array:
        """The way from the free one to the other: no row, or the one that was asked for."""
        return self.asked[None][: 0 if self.free is self.asked else 1]


def check_start(context: PlanningContext, q: Array, field: str = "start") -> Nearest:
    """What is nearest at the start of a path, the request's `field`. Raises PlanningFailed (`start_in_collision`)."""
    nearest = context.exact.nearest(q)
    if nearest.distance <= 0.0:
        raise PlanningFailed(
            f"the start is in collision: {_overlap(nearest)}; move the robot away by hand, or correct the scene",
            code="start_in_collision",
            field=field,
        )
    return nearest


def start_end(context: PlanningContext, q: Array, constraint: ConstraintManifold | None) -> End:
    """The start of a path. Raises PlanningFailed (`start_in_collision`)."""
    nearest = check_start(context, q)
    if (end := _end(context, q, constraint)) is None:
        raise PlanningFailed(
            f"there is no way out of the start, where {_gap(nearest)}; move the robot away by hand, or lower margin",
            code="start_in_collision",
            field="start",
        )
    return end


def rest_end(context: PlanningContext, q: Array) -> End | None:
    """The end at `q`, which is free of collision; None where no way leads from there to what is free in spheres."""
    return _end(context, q, None)


def goal_ends(
    context: PlanningContext,
    start: Array,
    goal: PoseGoal | JointGoal,
    field: str,
    constraint: ConstraintManifold | None,
) -> tuple[End, ...]:
    """The configurations that reach a goal, which is the request's `field`; the one nearest to `start` first.

    Of a goal set those that reach any of its poses. Raises PlanningFailed (`unreachable`, `goal_in_collision`),
    InvalidRequest for joints out of their range and for a goal that breaks the constraint, and what the deadline raises.
    """
    if isinstance(goal, JointGoal):
        q = within_range(context.model, goal.position, f"{field}.position")
        found = _free_ends(context, q[None], constraint)
        if not isinstance(found, _Fault) and constraint is not None:
            found = _broken(constraint, context.model.fk_tip(q)) or found
        if isinstance(found, _Fault):
            raise found.of_goal(field)
        return tuple(found)
    ends: list[End] = []
    faults: list[_Fault] = []
    most = min(_GOALS, _SET_GOALS // len(goal.poses))
    for number, pose in enumerate(goal.poses):
        found = _pose_ends(context, start, pose, most, constraint)
        if isinstance(found, _Fault):
            faults.append(found)
        else:
            ends += (replace(end, pose=number) for end in found)
    if not ends:
        raise faults[0].of_goal(field) if len(faults) == 1 else _of_all(faults, field)
    if goal.alternatives:
        ends.sort(key=lambda end: float(np.sum((end.asked - start) ** 2)))
    return tuple(ends)


@dataclass(frozen=True)
class _Fault:
    """Why a goal cannot be planned to, in words that follow "the goal" and "pose 2", and what to do about it."""

    code: Literal["unreachable", "goal_in_collision"] | None
    reason: str
    remedy: str

    def of_goal(self, field: str) -> ZarmError:
        """The error where this is the only goal; without a code, the request is at fault."""
        message = f"the goal {self.reason}; {self.remedy}"
        if self.code is None:
            return InvalidRequest(message, field=field)
        return PlanningFailed(message, code=self.code, field=field)


def _of_all(faults: Sequence[_Fault], field: str) -> ZarmError:
    """The error of a goal set of which no pose is left: the fault of each."""
    reasons = "; ".join(f"pose {number} {fault.reason}" for number, fault in enumerate(faults))
    message = f"none of the {len(faults)} poses of the goal is left: {reasons}; choose others, lower margin, or correct the scene"
    codes = {fault.code for fault in faults}
    if codes == {None}:
        return InvalidRequest(message, field=field)
    return PlanningFailed(
        message, code="goal_in_collision" if "goal_in_collision" in codes else "unreachable", field=field
    )


def _pose_ends(
    context: PlanningContext, start: Array, wanted: Pose, most: int, constraint: ConstraintManifold | None
) -> list[End] | _Fault:
    """The `most` nearest configurations that reach a pose."""
    pose = matrix(wanted.position, wanted.orientation)
    if constraint is not None and (fault := _broken(constraint, pose)):
        return fault
    found = solve_ik(
        context.model,
        pose,
        start,
        world=context.world,
        max_solutions=_GOALS,
        seed=context.seed,
        deadline=context.deadline,
    )
    context.deadline.check()
    if len(found.solutions):
        return [End(q, q) for q in found.solutions[:most]]
    if len(found.colliding):
        return _free_ends(context, found.colliding[:most], constraint)
    return _Fault(
        "unreachable",
        f"cannot be reached: the tip comes within {1e3 * found.distance:.1f} mm and "
        f"{np.rad2deg(found.angle):.1f} deg of it at best",
        "choose a pose nearer to the robot or another orientation",
    )


def _free_ends(
    context: PlanningContext, candidates: Array, constraint: ConstraintManifold | None
) -> list[End] | _Fault:
    """Those of the configurations (n, dof) that are free in exact geometry and can be reached."""
    ends: list[End] = []
    obstacles = []
    for q in candidates:
        nearest = context.exact.nearest(q)
        if nearest.distance > 0.0 and (end := _end(context, q, constraint)):
            ends.append(end)
        else:
            obstacles.append(nearest)
    if ends:
        return ends
    nearest = max(obstacles, key=lambda nearest: nearest.distance)
    reason = f"in collision: {_overlap(nearest)}" if nearest.distance <= 0.0 else f"out of reach: {_gap(nearest)}"
    ways = f" in all {len(candidates)} ways to reach it" if len(candidates) > 1 else ""
    return _Fault("goal_in_collision", f"is{ways} {reason}", "choose another one, lower margin, or correct the scene")


def _broken(constraint: ConstraintManifold, pose: Array) -> _Fault | None:
    """The fault of a goal whose pose (4, 4) breaks the constraint."""
    if (lost := constraint.broken_at(pose)) is None:
        return None
    return _Fault(
        None,
        f"breaks the path constraint: there, {lost} as seen from the start",
        "choose a goal that agrees with the start in these components, or constrain fewer",
    )


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
