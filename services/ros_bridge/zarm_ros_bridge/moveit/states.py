"""States of the robot in MoveIt's messages."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from moveit_msgs.msg import MoveItErrorCodes as Val
from moveit_msgs.msg import RobotState, RobotTrajectory

from zarm_contract.messages import Plan
from zarm_ros_bridge.convert.fields import finite
from zarm_ros_bridge.convert.joints import known_as, ros_positions
from zarm_ros_bridge.convert.trajectories import ros_joint_trajectory
from zarm_ros_bridge.frames import Frames
from zarm_ros_bridge.moveit.error_codes import Refusal

Positions = tuple[float, ...]


def start_of(state: Any, frames: Frames, joints: Sequence[str], field: str) -> Positions | None:
    """The positions (rad) of a start state; what it leaves out is as measured, and None means all of it. Raises Refusal."""
    if state.multi_dof_joint_state.joint_names:
        raise Refusal(
            Val.INVALID_ROBOT_STATE,
            "the robot has no joints of several degrees of freedom; leave them out",
            f"{field}.multi_dof_joint_state",
        )
    names, values = state.joint_state.name, state.joint_state.position
    if not names and not len(values):
        return None
    if len(names) != len(values):
        raise Refusal(
            Val.INVALID_ROBOT_STATE,
            f"{len(values)} positions for {len(names)} names; give one for each",
            f"{field}.joint_state",
        )
    given = {
        known_as(name, joints): finite(value, f"{field}.joint_state.position[{i}]")
        for i, (name, value) in enumerate(zip(names, values, strict=True))
    }
    if all(joint in given for joint in joints):
        return tuple(given[joint] for joint in joints)
    return tuple(given.get(joint, at) for joint, at in zip(joints, frames.joints(), strict=True))


def robot_state(joints: Sequence[str], position: Sequence[float]) -> Any:
    """The state at these positions (rad)."""
    return RobotState(joint_state=ros_positions(joints, position))


def trajectory_start(plan: Plan) -> Any:
    """The state in which a plan begins."""
    return robot_state(plan.trajectory.joint_names, plan.trajectory.position[0])


def robot_trajectory(plan: Plan, frame: str) -> Any:
    """The motion of a plan."""
    trajectory = ros_joint_trajectory(plan.trajectory)
    trajectory.header.frame_id = frame
    return RobotTrajectory(joint_trajectory=trajectory)
