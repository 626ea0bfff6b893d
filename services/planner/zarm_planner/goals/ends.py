"""Start and goals of a path, and the nearest configurations from which the search can work.

Spheres are larger than the links that they cover. So a robot that holds its tool close to a table without touching it
seems to touch it; from there it first moves a little away, on a path that is free in exact geometry.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, NamedTuple, Protocol, Self

import numpy as np

from zarm_contract.errors import InvalidRequest, PlanningFailed, ZarmError
from zarm_contract.messages import Goal, JointGoal, Pose, PoseDeviation, PoseGoal, WaypointsGoal
from zarm_geometry.collision import is_free
from zarm_geometry.exact import Nearest
from zarm_geometry.frames import matrix
from zarm_planner.constraints.path_constraint import ConstraintManifold
from zarm_planner.context import PlanningContext
from zarm_planner.goals.contact import clear_pose, edge_is_free, points, way_out
from zarm_planner.goals.joints import within_range
from zarm_planner.kernels.inverse import DISTINCT
from zarm_planner.kinematics.ik import IkResult, solve_ik
from zarm_planner.kinematics.pose_region import PoseRegion
from zarm_trajectory.arrays import Array
from zarm_trajectory.turns import TURN, whole_turns

_GOALS = 16
"""Most solutions considered for a pose."""
_REGION_GOALS = 6
"""Most solutions considered for a pose with tolerance; each is the best of its surroundings."""
_SET_GOALS = 256
"""Most solutions considered for a goal set, equally many for each pose."""
_TIGHT_GOALS = 4
"""Most solutions considered at first for a pose that leaves the robot less room than its spheres take; each costs a
millisecond.
"""
_FRUITLESS = 5
"""Consecutive seeds without a new solution after which all solutions of a pose count as known; one seed finds 98 to
99.8 % of them.
"""
_TRIES = 40
"""Directions tried at each distance to get away from an obstacle on a straight edge."""
_DISTANCES = (0.02, 0.05, 0.1, 0.2, 0.4, 0.8)
"""Rad, Euclidean."""
_FURTHER = 1.5
"""Factor between distances tried beyond the first at which the robot is free."""
_ALONE = 4
"""Factor on the ways out tried from a configuration that cannot be replaced by another. From one in a window that
leaves the hand of a Panda 1 mm on all sides, `max_attempts` of 100 fail for one seed in 20.
"""


class End(NamedTuple):
    """A requested configuration, and the one for the search, which is free in spheres: the same where possible; (dof,)
    each.

    `way` (n, dof) leads from the free one, which it does not contain, to the requested one; it is empty if they are the
    same. `pose` is the index of the goal's pose that is reached, if the goal has poses.
    """

    asked: Array
    free: Array
    way: Array
    pose: int | None = None

    def turned(self, turns: Array) -> Self:
        """The same end after whole turns (dof,) in rad of continuous joints."""
        return self._replace(asked=self.asked + turns, free=self.free + turns, way=self.way + turns)

    @classmethod
    def at(cls, q: Array) -> Self:
        """The end at `q`, which is free in spheres."""
        return cls(q, q, np.empty((0, len(q))))


def check_start(context: PlanningContext, q: Array, field: str = "start") -> None:
    """Raises PlanningFailed (`start_in_collision`) if the start of a path, the request's `field`, is in collision."""
    if not context.exact.is_free(q):
        overlap = _overlap(context.exact.nearest(q))
        raise PlanningFailed(
            f"the start is in collision: {overlap}; move the robot away, with `zarm track` or by hand, or correct the scene",
            code="start_in_collision",
            field=field,
        )


def start_end(context: PlanningContext, q: Array, constraint: ConstraintManifold | None) -> End:
    """The start of a path. Raises PlanningFailed (`start_in_collision`)."""
    if is_free(context.model, context.world, q):
        context.assumptions.append(partial(check_start, context, q))
        return End.at(q)
    check_start(context, q)
    if (end := _end(context, q, constraint, _ALONE)) is None:
        nearest = context.exact.nearest(q, context.deadline.check)
        raise PlanningFailed(
            f"there is no way out of the start, where {_gap(nearest)}; move the robot away, with `zarm track` or by hand, or "
            f"lower {_margin_of(context, nearest)}",
            code="start_in_collision",
            field="start",
        )
    return end


def blocked_goal(context: PlanningContext, tried: Sequence[Array], field: str) -> ZarmError:
    """The error of a goal, the request's `field`, none of whose solutions (dof,) can be used."""
    clearances = [(context.exact.nearest(q, context.deadline.check).distance, q) for q in tried]
    return _blocked(context, clearances).of_goal(field)


def rest_end(context: PlanningContext, q: Array, constraint: ConstraintManifold | None) -> End | None:
    """The end at the collision-free `q`; None if no motion within the constraint leads from it to a configuration that
    the sphere check calls free.
    """
    return _end(context, q, constraint)


def broken_goal(constraint: ConstraintManifold, pose: Array, field: str) -> ZarmError | None:
    """The error of a goal, the request's `field`, if the pose (4, 4) that the constraint is about breaks it there."""
    fault = _broken(constraint, pose)
    return None if fault is None else fault.of_goal(field)


def goal_ends(
    context: PlanningContext,
    start: Array,
    goal: PoseGoal | JointGoal,
    field: str,
    constraint: ConstraintManifold | None,
) -> tuple[End, ...]:
    """The configurations that reach a goal, which is the request's `field`; the one nearest to `start` first.

    For a goal set, those that reach any of its poses. Continuous joints turn the short way from `start`; with
    `thorough_ik`, one of them also the long way. Raises PlanningFailed (`unreachable`, `goal_in_collision`),
    InvalidRequest for joints out of range and for a goal that breaks the constraint, and the deadline's error.
    """
    if isinstance(goal, JointGoal):
        q = within_range(context.model, goal.position, f"{field}.position")
        q = q + whole_turns(start - q, context.model.continuous)
        if is_free(context.model, context.world, q):
            end: End | None = End.at(q)
            context.assumptions.append(partial(_check_goal, context, q, field))
        else:
            _check_goal(context, q, field)
            end = _end(context, q, constraint, _ALONE)
        if end is None:
            raise _blocked(context, [(0.0, q)]).of_goal(field)
        if constraint is not None and (fault := broken_goal(constraint, constraint.poses(q), field)):
            raise fault
        return _with_long_ways(context, start, [end])
    if goal.approach is not None or goal.retreat is not None:  # a waypoint is passed without stopping
        raise InvalidRequest(
            "a waypoint has no approach or retreat; give the pose as the goal, or as a segment of a program",
            field=f"{field}.{'retreat' if goal.approach is None else 'approach'}",
        )
    ends: list[End] = []
    faults: list[_Fault] = []
    poses = goal.poses
    most = min(_GOALS, _SET_GOALS // len(poses))
    for number, pose in enumerate(poses):
        target = _target(context, goal, pose, field, constraint)
        found = _pose_ends(context, start, target, most, constraint)
        if isinstance(found, _Fault):
            faults.append(found)
        else:
            ends += (end._replace(pose=number) for end in found)
    if not ends:
        raise faults[0].of_goal(field) if len(faults) == 1 else _of_all(faults, field)
    if goal.alternatives:
        ends.sort(key=lambda end: float(np.sum((end.asked - start) ** 2)))
    return _with_long_ways(context, start, ends)


def goal_deviation(context: PlanningContext, goal: Goal, number: int | None, q: Array) -> PoseDeviation | None:
    """By how much the end `q` (dof,) of a motion is off pose `number` of the goal; None for a goal without freedom."""
    last = goal.through[-1] if isinstance(goal, WaypointsGoal) else goal
    if number is None or not isinstance(last, PoseGoal) or not last.has_freedom:
        return None
    return PoseRegion.of(context.model, last.poses[number], last.tolerance, last.tip, "goal").deviation(q)


def _with_long_ways(context: PlanningContext, start: Array, ends: list[End]) -> tuple[End, ...]:
    """These ends; with `thorough_ik` then also those that turn one continuous joint the long way from `start` (dof,),
    since something may be in the short way.
    """
    longer: list[End] = []
    if context.thorough_ik:
        for joint in np.flatnonzero(context.model.continuous):
            turn = TURN * np.eye(context.model.dof)[joint]
            longer += [end.turned(turn if end.asked[joint] < start[joint] else -turn) for end in ends]
    return (*ends, *longer)


def _check_goal(context: PlanningContext, q: Array, field: str) -> None:
    """Raises PlanningFailed (`goal_in_collision`) if the goal's joints, the request's `field`, are in collision."""
    if not context.exact.is_free(q):
        raise _blocked(context, [(0.0, q)]).of_goal(field)


@dataclass(frozen=True)
class _Fault:
    """Why no plan to a goal is possible, in words that follow "the goal" and "pose 2", and the remedy."""

    code: Literal["unreachable", "goal_in_collision"] | None
    reason: str
    remedy: str

    def of_goal(self, field: str) -> ZarmError:
        """The error if this is the only goal; without a code, the request is at fault."""
        message = f"the goal {self.reason}; {self.remedy}"
        if self.code is None:
            return InvalidRequest(message, field=field)
        return PlanningFailed(message, code=self.code, field=field)


def _of_all(faults: Sequence[_Fault], field: str) -> ZarmError:
    """The error of a goal set without any usable pose: the fault of each."""
    reasons = "; ".join(f"pose {number} {fault.reason}" for number, fault in enumerate(faults))
    message = f"none of the {len(faults)} poses of the goal is left: {reasons}; choose others, lower margin, or correct the scene"
    codes = {fault.code for fault in faults}
    if codes == {None}:
        return InvalidRequest(message, field=field)
    return PlanningFailed(
        message, code="goal_in_collision" if "goal_in_collision" in codes else "unreachable", field=field
    )


class _Target(Protocol):
    """The poses that a goal allows."""

    def solve(self, context: PlanningContext, near: Array) -> IkResult:
        """Joints that reach one of the poses, nearest to `near` (dof,) first, free in spheres."""

    def tip(self, q: Array) -> Array:
        """The pose (4, 4) of the tip at the solution `q` (dof,)."""

    def fault(self, constraint: ConstraintManifold | None) -> _Fault | None:
        """What keeps it from being a goal at all."""

    def unreachable(self, context: PlanningContext, near: Array, found: IkResult) -> _Fault:
        """The fault of a goal without solutions."""


@dataclass(frozen=True)
class _ExactPose:
    """One pose of the tip."""

    message: Pose
    pose: Array

    def solve(self, context: PlanningContext, near: Array) -> IkResult:
        return solve_ik(
            context.model,
            self.pose,
            near,
            world=context.world,
            max_solutions=_GOALS,
            seed=context.seed,
            deadline=context.deadline,
        )

    def tip(self, q: Array) -> Array:
        return self.pose

    def fault(self, constraint: ConstraintManifold | None) -> _Fault | None:
        return None if constraint is None else _broken(constraint, self.pose)

    def unreachable(self, context: PlanningContext, near: Array, found: IkResult) -> _Fault:
        region = PoseRegion.of(context.model, self.message, None, None, "")
        return _Fault(
            "unreachable",
            f"cannot be reached: the tip comes within {1e3 * found.distance:.1f} mm and "
            f"{np.rad2deg(found.angle):.1f} deg of it at best",
            _freeing(context, region, near) or "choose a pose nearer to the robot or another orientation",
        )


@dataclass(frozen=True)
class _Region:
    """The poses around a goal's pose that its tolerance allows, or the pose of another frame of the robot."""

    region: PoseRegion

    def solve(self, context: PlanningContext, near: Array) -> IkResult:
        return self._solve(context, near)[0]

    def _solve(self, context: PlanningContext, near: Array) -> tuple[IkResult, Array]:
        return self.region.solve(
            near, world=context.world, max_solutions=_REGION_GOALS, seed=context.seed, deadline=context.deadline
        )

    def tip(self, q: Array) -> Array:
        return self.region.model.fk_tip(q)

    def fault(self, constraint: ConstraintManifold | None) -> _Fault | None:
        return None

    def unreachable(self, context: PlanningContext, near: Array, found: IkResult) -> _Fault:
        _, missed = self._solve(context, near)
        return _Fault(
            "unreachable",
            f"cannot be reached: at best, {self.region.shortfall(missed)}",
            _freeing(context, self.region, near) or "choose a pose nearer to the robot, or allow more",
        )


def _freeing(context: PlanningContext, region: PoseRegion, near: Array) -> str | None:
    """The remedy that names the components to free, one of which is enough; or all of the orientation."""
    names = region.blocking(near, context.seed, context.deadline)
    if (
        not names
        and region.with_any_turn.solve(near, world=None, max_solutions=1, seed=context.seed, deadline=context.deadline)[
            0
        ].solutions.size
    ):
        return "it can be reached with theta_x, theta_y and theta_z free, see goal.tolerance"
    return f"it can be reached with {' or '.join(names)} free, see goal.tolerance" if names else None


def _target(
    context: PlanningContext, goal: PoseGoal, pose: Pose, field: str, constraint: ConstraintManifold | None
) -> _Target:
    if not goal.has_freedom:
        return _ExactPose(pose, matrix(pose.position, pose.orientation))
    kept = None if constraint is None else constraint.arrays
    return _Region(PoseRegion.of(context.model, pose, goal.tolerance, goal.tip, f"{field}.tip", kept))


def _pose_ends(
    context: PlanningContext, start: Array, target: _Target, most: int, constraint: ConstraintManifold | None
) -> list[End] | _Fault:
    """The `most` nearest configurations that reach a pose of the target."""
    if fault := target.fault(constraint):
        return fault
    found = _solved(context, target, start)
    if len(found.solutions):
        return [End.at(q) for q in found.solutions[:most]]
    if len(found.colliding):
        return _tight_ends(context, start, target, found.colliding, most, constraint)
    return target.unreachable(context, start, found)


def _tight_ends(
    context: PlanningContext,
    start: Array,
    target: _Target,
    found: Array,
    most: int,
    constraint: ConstraintManifold | None,
) -> list[End] | _Fault:
    """The `most` nearest configurations, free in exact geometry, for a target with no solution free in spheres.

    First the colliding ones `found` (n, dof), with as much clearance as the pose leaves them; then others, for
    `max_attempts` seeds or until _FRUITLESS in a row find nothing new.
    """
    if not context.thorough_ik:
        most = min(most, _TIGHT_GOALS)
    known = np.empty((0, context.model.dof))
    tried: list[tuple[float, Array]] = []
    fruitless = 0
    for attempt in range(context.max_attempts):
        if attempt > 0:
            solved = _solved(context.with_seed(context.seed + attempt), target, start)
            if len(solved.solutions):
                return [End.at(q) for q in solved.solutions[:most]]
            found = solved.colliding
        new = [q for q in found if not np.any(np.abs(known - q).max(axis=1) < DISTINCT)]
        fruitless = 0 if new else fruitless + 1
        if fruitless == _FRUITLESS:
            break
        known = np.vstack((known, *new))
        ends: list[End] = []
        for q in new:
            context.deadline.check()
            clear, clearance = clear_pose(context, target.tip(q), q)
            tried.append((clearance, clear))
            if clearance > 0.0 and (end := _end(context, clear, constraint)):
                ends.append(end)
            if len(ends) == most:
                break
        if ends:
            return ends
    return _blocked(context, tried)


def _solved(context: PlanningContext, target: _Target, near: Array) -> IkResult:
    """Joints for a target, free in spheres, and with `thorough_ik` in exact geometry too. Raises the deadline's error."""
    found = target.solve(context, near)
    context.deadline.check()
    if not context.thorough_ik:
        return found
    free = np.array([context.exact.is_free(q, context.deadline.check) for q in found.solutions], np.bool_)
    colliding = np.concatenate((found.solutions[~free], found.colliding))
    return replace(found, solutions=found.solutions[free], colliding=colliding)


def _blocked(context: PlanningContext, tried: Sequence[tuple[float, Array]]) -> _Fault:
    """The fault of a goal whose solutions are all unusable: the clearance (m) and joints (dof,) of each."""
    _, roomiest = max(tried, key=lambda one: one[0])
    best = context.exact.nearest(roomiest, context.deadline.check)
    reason, remedy = f"in collision: {_overlap(best)}", "choose another one, or correct the scene"
    if best.distance > 0.0:
        reason = f"out of reach: {_gap(best)}"
        remedy = f"choose another one, lower {_margin_of(context, best)}, or correct the scene"
    ways = f" in all {len(tried)} ways to reach it" if len(tried) > 1 else ""
    return _Fault("goal_in_collision", f"is{ways} {reason}", remedy)


def _broken(constraint: ConstraintManifold, pose: Array) -> _Fault | None:
    """The fault of a goal whose pose (4, 4) breaks the constraint."""
    if (lost := constraint.broken_at(pose)) is None:
        return None
    return _Fault(
        None,
        f"breaks the path constraint: there, {lost} as seen from the start",
        "choose a goal that agrees with the start in these components, or constrain fewer",
    )


def _end(context: PlanningContext, q: Array, constraint: ConstraintManifold | None, times: int = 1) -> End | None:
    """The end at `q`, which is free of collision; None if no way within the constraint leads to a configuration free in
    spheres.

    Tries `times` as many ways as `max_attempts`.
    """
    if is_free(context.model, context.world, q):
        return End.at(q)
    model, random = context.model, np.random.default_rng(context.seed)
    for distance in _DISTANCES:
        for direction in random.normal(size=(_TRIES, model.dof)):
            context.deadline.check()
            near = np.clip(q + distance * direction / np.linalg.norm(direction), model.lower, model.upper)
            if constraint is not None:
                if (kept := constraint.projected(near)) is None:
                    continue
                near = kept[0]
                if constraint.use(points(context.exact, q, near)).max() > 1.0:
                    continue
            if is_free(model, context.world, near) and edge_is_free(context, q, near):
                return End(q, near if constraint is not None else _roomier(context, q, near), q[None])
    if constraint is not None:
        return None
    for direction in random.normal(size=(times * context.max_attempts, model.dof)):
        way = way_out(context, q, direction / np.linalg.norm(direction))
        context.deadline.check()
        if way is not None:
            return End(q, way[-1], way[-2::-1])
    return None


def _roomier(context: PlanningContext, q: Array, near: Array) -> Array:
    """A configuration beyond `near` as seen from `q`, as far as it stays free in spheres and the straight edge from `q`
    is free in exact geometry; each (dof,).

    A search finds `near` itself with difficulty, since an obstacle is just beside it.
    """
    model, distance, furthest = context.model, float(np.linalg.norm(near - q)), near
    direction = (near - q) / distance
    while (distance := distance * _FURTHER) <= _DISTANCES[-1]:
        further = np.clip(q + distance * direction, model.lower, model.upper)
        if not is_free(model, context.world, further):
            break
        furthest = further
    return furthest if edge_is_free(context, q, furthest) else near


def _overlap(nearest: Nearest) -> str:
    a, b = nearest.pair or ("", "")
    return f"{a} is {-1e3 * nearest.distance:.1f} mm inside {b}"


def _gap(nearest: Nearest) -> str:
    a, b = nearest.pair or ("", "")
    return f"{a} is only {1e3 * nearest.distance:.1f} mm from {b}"


def _margin_of(context: PlanningContext, nearest: Nearest) -> str:
    """The field of the request that says how far the two keep from each other."""
    return "self_margin" if nearest.pair and nearest.pair[1] in context.model.links else "margin"
