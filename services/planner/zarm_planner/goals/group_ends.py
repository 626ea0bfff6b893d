"""Goals of several groups at once: the configurations that reach all of them."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from zarm_contract.errors import InvalidRequest, PlanningFailed
from zarm_contract.messages import GroupGoal, GroupsGoal, PoseGoal
from zarm_geometry.collision import is_free
from zarm_geometry.exact import ExactScene
from zarm_geometry.frames import pose_of
from zarm_planner.constraints.constrained_search import led_to
from zarm_planner.constraints.path_constraint import ConstraintManifold
from zarm_planner.context import PlanningContext
from zarm_planner.goals.ends import End, blocked_goal, broken_goal, goal_ends, rest_end
from zarm_planner.scene.planning_scene import PlanningScene
from zarm_trajectory.arrays import Array

_MAX_CONFIGURATIONS = 16
"""Most configurations considered for a goal of several groups."""
_ALTOGETHER = 256
"""Most combinations of solutions of the groups that are looked at, those nearest to the start."""
_DIFFERENT = 4
"""Most solutions of a group for which one that it carries, or at first one that follows it, is solved."""


class _Reached(NamedTuple):
    """A configuration (dof,) that reaches the goals of some groups, and the index of the pose of the first that has poses."""

    q: Array
    pose: int | None = None


def group_ends(
    context: PlanningContext, start: Array, goal: GroupsGoal, field: str, constraint: ConstraintManifold | None
) -> tuple[End, ...]:
    """The configurations that reach the goals of all groups, which are the request's `field`; the one nearest to `start`
    (dof,) first.

    Each group is solved without the others, and of the combinations those count that are free together and keep the constraint. A
    group that it holds, and that has no goal, follows. Raises as `goal_ends` does.
    """
    combined = [_Reached(start)]
    parts = _carriers_first(context, goal, field)
    held = None if context.path_constraint is None else _without_goal(context, goal, context.path_constraint.group)
    for order, (number, part) in enumerate(parts):
        later = {joint for _, each in parts[order + 1 :] for joint in _joints(context, each.group)}
        if held is not None:
            later.update(_joints(context, held))
        combined = _with_part(context, combined, part, later, f"{field}.goals.{number}.goal")
    if constraint is not None and held is not None:
        combined = _following(context, start, combined, held, constraint)
    elif constraint is not None:
        combined = _keeping(constraint, combined, field)
    combined.sort(key=lambda each: float(np.sum((each.q - start) ** 2)))
    ends: list[End] = []
    for q, pose in combined[:_ALTOGETHER]:
        if is_free(context.model, context.world, q) and (not context.thorough_ik or context.exact.is_free(q)):
            ends.append(End.at(q)._replace(pose=pose))
        if len(ends) == (_MAX_CONFIGURATIONS if constraint is None else _ALTOGETHER):
            break
    for q, pose in [] if ends else combined[:_MAX_CONFIGURATIONS]:
        context.deadline.check()
        if context.exact.is_free(q) and (end := rest_end(context, q, constraint)) is not None:
            ends.append(end._replace(pose=pose))
    if not ends:
        raise blocked_goal(context, [q for q, _ in combined[:_MAX_CONFIGURATIONS]], field)
    return tuple(ends)


def _without_goal(context: PlanningContext, goal: GroupsGoal, group: str | None) -> str | None:
    """This group, if its joints move, and none of them has a goal."""
    joints = set() if group is None else {*_joints(context, group)}
    named = {joint for part in goal.goals for joint in _joints(context, part.group)}
    return group if joints and not joints & named else None


def _following(
    context: PlanningContext, start: Array, begun: list[_Reached], group: str, constraint: ConstraintManifold
) -> list[_Reached]:
    """The configurations `begun` with one more group, whose tip keeps the constraint: the free ones to which it leads straight
    from `start` (dof,); with `thorough_ik`, or if there are none, all. Raises PlanningFailed.
    """
    made: list[_Reached] = []
    for most in (_MAX_CONFIGURATIONS,) if context.thorough_ik else (_DIFFERENT, _MAX_CONFIGURATIONS):
        last = most == _MAX_CONFIGURATIONS or most >= len(begun)
        try:
            made = _with_follower(context, begun[:most], group, constraint)
        except PlanningFailed:
            if last:
                raise
            continue
        if not context.thorough_ik:
            free = [one for one in made if is_free(context.model, context.world, one.q)]
            straight = led_to(constraint, start, np.array([q for q, _ in free]).reshape(-1, len(start)))
            if straight.any():
                return list(itertools.compress(free, straight))
        if last:
            break
    return made


def _with_follower(
    context: PlanningContext, begun: list[_Reached], group: str, constraint: ConstraintManifold
) -> list[_Reached]:
    """The configurations `begun`, where the tip of one more group keeps the constraint. Raises PlanningFailed."""
    made: list[_Reached] = []
    failure: PlanningFailed | None = None
    for one in begun:
        pose = pose_of(constraint.tip(one.q))
        goal = PoseGoal.model_construct(kind="pose", position=pose.position, orientation=pose.orientation)
        part = GroupGoal.model_construct(group=group, goal=goal)
        try:
            made += _with_part(context, [one], part, set(), "path_constraint.group", known=True)
        except PlanningFailed as error:
            failure = error
    if failure is not None and not made:
        raise PlanningFailed(
            f"{group} cannot follow: {failure}", code=failure.problem.code, field="path_constraint.group"
        ) from failure
    return made


def _keeping(constraint: ConstraintManifold, reached: list[_Reached], field: str) -> list[_Reached]:
    """Those that keep the constraint. Raises InvalidRequest if there are none."""
    used = constraint.use(np.array([q for q, _ in reached]))
    kept = [one for one, use in zip(reached, used, strict=True) if use <= 1.0]
    nearest = reached[int(used.argmin())].q
    if not kept and (broken := broken_goal(constraint, constraint.poses(nearest), field)):
        raise broken
    return kept


def _carriers_first(context: PlanningContext, goal: GroupsGoal, field: str) -> list[tuple[int, GroupGoal]]:
    """The goals with their numbers, each after those of the groups that carry its own. Raises InvalidRequest for two groups that
    carry each other.
    """
    parts = sorted(enumerate(goal.goals), key=lambda each: min(_joints(context, each[1].group)))
    for order, (number, part) in enumerate(parts):
        carriers = {joint for own in _joints(context, part.group) for joint in context.model.ancestors(own)}
        for _, later in parts[order + 1 :]:
            if carriers & {*_joints(context, later.group)}:
                raise InvalidRequest(
                    f"{part.group} and {later.group} carry each other; name groups of which one carries the other",
                    field=f"{field}.goals.{number}.group",
                )
    return parts


def _joints(context: PlanningContext, group: str) -> list[int]:
    """The indices of a group's joints."""
    robot = context.model.robot
    return [robot.descriptor.joints.index(joint) for joint in robot.group_joints(group)]


def _with_part(
    context: PlanningContext,
    begun: list[_Reached],
    part: GroupGoal,
    later: set[int],
    field: str,
    *,
    known: bool = False,
) -> list[_Reached]:
    """The configurations `begun` with the joints of one more group as its goal asks; those of `later` groups come next.

    It is solved for several of them if other joints of the goal carry it, or if where these end is `known` otherwise.
    """
    if isinstance(part.goal, PoseGoal) and (part.goal.approach is not None or part.goal.retreat is not None):
        raise InvalidRequest(
            "groups that move together have no approach or retreat; move them one after the other in a program",
            field=field,
        )
    model = context.model
    joints = _joints(context, part.group)
    others = set(range(model.dof)) - set(joints)
    known = known or any(joint in others for own in joints for joint in model.ancestors(own))
    # What other joints of the goal move is elsewhere in the end, unless they are solved.
    unknown = later if known else others
    elsewhere = [body.name for body in model.bodies if unknown & {*model.ancestors(body.joint)}]
    made: list[_Reached] = []
    failure: PlanningFailed | None = None
    for first in begun[: _DIFFERENT if known else 1]:
        q = first.q
        alone = model.group((part.group,), q, without=elsewhere)
        scene = PlanningScene(context.scene.revision, alone, context.world, ExactScene(alone, context.exact.world))
        of_part = replace(context, scene=scene.with_self_margin(context.scene.self_margin))
        try:
            solutions = goal_ends(of_part, q[joints], part.goal, field, None)
        except PlanningFailed as error:
            failure = error
            continue
        for one in [first] if known else begun:
            for solution in solutions:
                together = one.q.copy()
                together[joints] = solution.asked
                made.append(_Reached(together, solution.pose if one.pose is None else one.pose))
    if not made and failure is not None:
        raise failure
    return made
