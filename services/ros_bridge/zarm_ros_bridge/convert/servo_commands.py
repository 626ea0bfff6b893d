"""Commands from clients of MoveIt Servo, and its status codes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from geometry_msgs.msg import PoseStamped, TwistStamped

from zarm.servoing import Jogging, Tracking
from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import Vector3
from zarm_contract.messages.servo import Limiting
from zarm_contract.robot import RobotDescriptor
from zarm_ros_bridge.convert.fields import finite
from zarm_ros_bridge.convert.joints import known_as
from zarm_ros_bridge.convert.poses import pose_of

Send = Callable[[Any], None]
"""Sends a target to a session, Tracking or Jogging."""

INVALID, NO_WARNING = -1, 0
STATUS: Mapping[Limiting, int] = {
    "free": NO_WARNING,
    "target_stale": NO_WARNING,
    "singularity": 1,  # DECELERATE_FOR_APPROACHING_SINGULARITY
    "slowing": 4,  # DECELERATE_FOR_COLLISION
    "blocked": 5,  # HALT_FOR_COLLISION
    "joint_limit": 6,  # JOINT_BOUND
}
"""Codes of moveit_msgs/msg/ServoStatus (ROS 2 Jazzy), by what limits a session."""


def twist_of(message: TwistStamped, robot: RobotDescriptor) -> Send:
    """Velocities of the tip (m/s, rad/s) along the axes of the base or of the tool, as `frame_id` says.

    Raises InvalidRequest for another frame, and for values that are not finite.
    """
    frame = _frame(message.header.frame_id, {robot.base_link: "base", robot.tip_link: "tool"})
    linear, angular = (_vector(getattr(message.twist, name), f"twist.{name}") for name in ("linear", "angular"))

    def send(session: Jogging) -> None:
        session.twist(linear, angular, frame="tool" if frame == "tool" else "base")

    return send


def target_of(message: PoseStamped, robot: RobotDescriptor) -> Send:
    """A pose of the tip in the base frame. Raises InvalidRequest for another frame, and for an invalid pose."""
    _frame(message.header.frame_id, {robot.base_link: "base"})
    pose = pose_of(message.pose, "pose")

    def send(session: Tracking) -> None:
        session.to(pose)

    return send


def joint_speed_of(message: Any, robot: RobotDescriptor) -> Send:
    """Joint speeds (rad/s), by name, of a sensor_msgs/JointState or a control_msgs/JointJog; unnamed joints stand
    still.

    Raises InvalidRequest for an unknown joint, displacements, and values that are not finite.
    """
    if hasattr(message, "joint_names"):
        names, speeds, field = message.joint_names, message.velocities, "velocities"
        if len(message.displacements):
            raise InvalidRequest("displacements are not followed; give velocities (rad/s)", field="displacements")
    else:
        names, speeds, field = message.name, message.velocity, "velocity"
    velocity = _by_joint(names, speeds, robot.joints, field)

    def send(session: Jogging) -> None:
        session.joint_speed(velocity)

    return send


def _by_joint(names: Sequence[str], speeds: Sequence[float], joints: Sequence[str], field: str) -> tuple[float, ...]:
    names = names or joints
    if len(speeds) != len(names):
        raise InvalidRequest(f"{len(speeds)} speeds for {len(names)} joints; give one for each", field=field)
    reported = {
        known_as(name, joints): finite(speed, f"{field}[{i}]")
        for i, (name, speed) in enumerate(zip(names, speeds, strict=True))
    }
    if unknown := set(reported) - set(joints):
        raise InvalidRequest(
            f"there is no joint {', '.join(sorted(unknown))}; this robot has {', '.join(joints)}", field=field
        )
    return tuple(reported.get(joint, 0.0) for joint in joints)


def _frame(frame_id: str, frames: Mapping[str, str]) -> str:
    """Which of the frames is meant; an empty one means the first, the base."""
    base = next(iter(frames))
    link = known_as(frame_id.removeprefix("/") or base, frames)
    if link not in frames:
        raise InvalidRequest(
            f"the frame {frame_id!r} is not supported for commands; use {' or '.join(frames)}", field="header.frame_id"
        )
    return frames[link]


def _vector(message: Any, field: str) -> Vector3:
    x, y, z = (finite(getattr(message, axis), f"{field}.{axis}") for axis in "xyz")
    return x, y, z
