"""The planning groups of a robot's joints by their names in MoveIt: all joints, and the groups of the descriptor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from moveit_msgs.msg import MoveItErrorCodes as Val

from zarm_contract.robot import RobotDescription
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.moveit.error_codes import Refusal
from zarm_ros_bridge.moveit.states import Positions


@dataclass(frozen=True)
class ArmGroup:
    """Joints that are planned together: `robot` is the robot with these alone, and their tip. `name` is that of the descriptor's
    group, None for all joints; `joints` are the indices of its joints among the robot's.
    """

    name: str | None
    robot: RobotDescription
    joints: tuple[int, ...]

    def part(self, positions: Sequence[float]) -> Positions:
        """The positions (rad) of its joints among those of the robot."""
        return tuple(positions[k] for k in self.joints)

    @property
    def arms(self) -> dict[str, RobotDescription]:
        """The groups with one tip each that a group with several tips consists of; none of a group with one."""
        robot = self.robot.whole or self.robot
        groups = robot.descriptor.groups
        if self.name is not None:
            return {part: robot.group(part) for part in groups[self.name].groups}
        arms = {name: robot.group(name) for name, group in groups.items() if group.tip_link is not None}
        whole = any(arm.descriptor.joints == robot.descriptor.joints for arm in arms.values())
        return {} if whole else arms

    def whole(self, part: Sequence[float], positions: Sequence[float]) -> Positions:
        """`positions` (rad) of the robot, with those of the group's joints in place of its own."""
        found = np.array(positions, np.float64)
        found[list(self.joints)] = part
        return tuple(found.tolist())


class ArmGroups:
    """The groups that clients of MoveIt name. `default` is the name of the group of all joints."""

    def __init__(self, engine: Engine, default: str) -> None:
        self._engine, robot = engine, engine.robot
        self._groups = {default: ArmGroup(None, robot, tuple(range(len(robot.descriptor.joints))))}
        for name in robot.descriptor.groups:
            part = robot.group(name)
            joints = tuple(robot.descriptor.joints.index(joint) for joint in part.descriptor.joints)
            self._groups[name] = ArmGroup(name, part, joints)

    def of(self, name: str) -> ArmGroup:
        """The group of this name, with the tip of the tool that is mounted. Raises Refusal."""
        if name not in self._groups:
            known = ", ".join(map(repr, self._groups))
            raise Refusal(
                Val.INVALID_GROUP_NAME,
                f"there is no group {name!r}; this robot has {known}, where the first is the one that the bridge is started with: --group",
                "group_name",
            )
        group, tooled = self._groups[name], self._engine.tooled
        if tooled is self._engine.robot:
            return group
        return replace(group, robot=tooled if group.name is None else tooled.group(group.name))


def arm_of(link: str, arms: Mapping[str, RobotDescription], field: str) -> str:
    """The arm with the fewest joints among those that move a link. Raises Refusal if none does."""
    moving = {}
    for name, arm in arms.items():
        chain = {joint.name for joint in arm.urdf.chain(arm.descriptor.base_link, link)}
        if chain & {*arm.descriptor.joints}:
            moving[name] = len(arm.descriptor.joints)
    if not moving:
        raise Refusal(
            Val.INVALID_LINK_NAME, f"{link} is moved by none of {', '.join(arms)}; constrain a link of theirs", field
        )
    return min(moving, key=moving.__getitem__)
