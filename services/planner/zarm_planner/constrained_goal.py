"""Which groups a path constraint is about, and which of them follows what the goal moves."""

from __future__ import annotations

from typing import NamedTuple

from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import Goal, GroupGoal, GroupsGoal, JointGoal, PathConstraint, PoseGoal, WaypointsGoal
from zarm_contract.robot import RobotDescription
from zarm_planner.group import Group

_HELD, _REFERENCE = "path_constraint.group", "path_constraint.relative_to"


class ConstrainedGoal(NamedTuple):
    """A goal, the group that moves there, and the path constraint with the group whose tip it holds."""

    goal: Goal
    group: Group | None
    constraint: PathConstraint

    @classmethod
    def of(
        cls, robot: RobotDescription, goal: Goal, group: Group | None, constraint: PathConstraint
    ) -> ConstrainedGoal:
        """That of a request for a `group`. If the goal moves only the tip in whose frame another one is held, the group of the
        latter moves along.

        Raises InvalidRequest for unknown groups, and for a constraint that does not say which of several tips it holds.
        """
        held = constraint.group
        if held is None:
            named = () if group is None else group.names
            held = named[0] if len(named) == 1 else None
        robot.check_tip(held, _HELD)
        reference = constraint.relative_to
        if reference is not None:
            robot.check_tip(reference, _REFERENCE)
            if held is None or reference == held:
                raise InvalidRequest(
                    "a tip is held relative to that of another group; name another one", field=_REFERENCE
                )
        constraint = constraint.model_copy(update={"group": held})
        if held is None or group is None or group.names == (held,):
            return cls(goal, group, constraint)
        follows = _follows(robot, held, reference, group)
        if isinstance(goal, WaypointsGoal) and (follows or any(isinstance(each, PoseGoal) for each in goal.through)):
            raise InvalidRequest(
                f"on a way through several waypoints the tip that is held, that of {held}, is that of the goal; leave the "
                "constraint's group out, or move to one waypoint after the other",
                field=_HELD,
            )
        if isinstance(goal, PoseGoal) or (isinstance(goal, JointGoal) and follows):
            parts = (GroupGoal.model_construct(group=group.names[0], goal=goal),)
            goal = GroupsGoal.model_construct(kind="groups", goals=parts)
        return cls(goal, group.with_group(robot, held) if follows else group, constraint)


def _follows(robot: RobotDescription, held: str, reference: str | None, group: Group) -> bool:
    """Whether the tip of `held` would be left behind, or be taken along, unless its own joints move too."""
    moving = {robot.descriptor.joints[joint] for joint in group.joints}
    if moving & {*robot.group_joints(held)}:
        return False
    return bool(moving & (_carriers(robot, held) ^ (_carriers(robot, reference) if reference is not None else set())))


def _carriers(robot: RobotDescription, group: str) -> set[str]:
    """The joints that move the tip of a group."""
    return {joint.name for joint in robot.urdf.chain(robot.descriptor.base_link, robot.tip_of((group,)))}
