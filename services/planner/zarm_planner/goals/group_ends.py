"""Goals of several groups at once: the configurations that reach all of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from zarm_contract.errors import InvalidRequest, PlanningFailed
from zarm_contract.messages import GroupGoal, GroupsGoal, PoseGoal
from zarm_geometry.collision import is_free
from zarm_geometry.exact import ExactScene
from zarm_planner.context import PlanningContext
from zarm_planner.goals.ends import End, blocked_goal, goal_ends, rest_end
from zarm_planner.scene.planning_scene import PlanningScene

Array = NDArray[np.float64]

_MOST = 16
"""Most configurations considered for a goal of several groups."""
_ALTOGETHER = 256
"""Most combinations of solutions of the groups that are looked at, those nearest to the start."""
_DIFFERENT = 4
"""Most solutions of a group for which one that it carries is solved."""


def group_ends(context: PlanningContext, start: Array, goal: GroupsGoal, field: str) -> tuple[End, ...]:
    """The configurations that reach the goals of all groups, which are the request's `field`; the one nearest to `start`
    (dof,) first.

    Each group is solved without the others, and of the combinations those count that are free together. Raises as
    `goal_ends` does.
    """
    combined = [start]
    parts = _carriers_first(context, goal, field)
    for order, (number, part) in enumerate(parts):
        later = {joint for _, each in parts[order + 1 :] for joint in _joints(context, each)}
        combined = _with_part(context, combined, part, later, f"{field}.goals.{number}.goal")
    combined.sort(key=lambda q: float(np.sum((q - start) ** 2)))
    pose = 0 if any(isinstance(part.goal, PoseGoal) for part in goal.goals) else None
    ends: list[End] = []
    for q in combined[:_ALTOGETHER]:
        if is_free(context.model, context.world, q) and (not context.thorough_ik or context.exact.is_free(q)):
            ends.append(End.at(q)._replace(pose=pose))
        if len(ends) == _MOST:
            break
    for q in [] if ends else combined[:_MOST]:
        context.deadline.check()
        if context.exact.is_free(q) and (end := rest_end(context, q)) is not None:
            ends.append(end._replace(pose=pose))
    if not ends:
        raise blocked_goal(context, combined[:_MOST], field)
    return tuple(ends)


def _carriers_first(context: PlanningContext, goal: GroupsGoal, field: str) -> list[tuple[int, GroupGoal]]:
    """The goals with their numbers, each after those of the groups that carry its own. Raises InvalidRequest for two groups that
    carry each other.
    """
    parts = sorted(enumerate(goal.goals), key=lambda each: min(_joints(context, each[1])))
    for order, (number, part) in enumerate(parts):
        carriers = {joint for own in _joints(context, part) for joint in context.model.ancestors(own)}
        for _, later in parts[order + 1 :]:
            if carriers & {*_joints(context, later)}:
                raise InvalidRequest(
                    f"{part.group} and {later.group} carry each other; name groups of which one carries the other",
                    field=f"{field}.goals.{number}.group",
                )
    return parts


def _joints(context: PlanningContext, part: GroupGoal) -> list[int]:
    """The indices of a group's joints."""
    robot = context.model.robot
    return [robot.descriptor.joints.index(joint) for joint in robot.group_joints(part.group)]


def _with_part(
    context: PlanningContext, begun: list[Array], part: GroupGoal, later: set[int], field: str
) -> list[Array]:
    """The configurations `begun` with the joints of one more group as its goal asks; those of `later` groups follow."""
    if isinstance(part.goal, PoseGoal) and (part.goal.approach is not None or part.goal.retreat is not None):
        raise InvalidRequest(
            "groups that move together have no approach or retreat; move them one after the other in a program",
            field=field,
        )
    model = context.model
    joints = _joints(context, part)
    others = set(range(model.dof)) - set(joints)
    carried = any(joint in others for own in joints for joint in model.ancestors(own))
    # What other joints of the goal move is elsewhere in the end, unless they carry this group, and are solved.
    unknown = later if carried else others
    elsewhere = [body.name for body in model.bodies if unknown & {*model.ancestors(body.joint)}]
    made: list[Array] = []
    failure: PlanningFailed | None = None
    for q in begun[: _DIFFERENT if carried else 1]:
        alone = model.group((part.group,), q, without=elsewhere)
        scene = PlanningScene(context.scene.revision, alone, context.world, ExactScene(alone, context.exact.world))
        of_part = replace(context, scene=scene.with_self_margin(context.scene.self_margin))
        try:
            solutions = [end.asked for end in goal_ends(of_part, q[joints], part.goal, field, None)]
        except PlanningFailed as error:
            failure = error
            continue
        for one in [q] if carried else begun:
            for solution in solutions:
                made.append(one.copy())
                made[-1][joints] = solution
    if not made and failure is not None:
        raise failure
    return made
