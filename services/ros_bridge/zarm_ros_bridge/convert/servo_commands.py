"""Commands from clients of MoveIt Servo, and its status codes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal

import numpy as np
from geometry_msgs.msg import PoseStamped, TwistStamped
from numpy.typing import NDArray
from trajectory_msgs.msg import JointTrajectory

from zarm.servoing import ChunkTracking, Jogging, Tracking
from zarm_contract.descriptor import RobotDescriptor
from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import Vector3
from zarm_contract.messages.servo import Limiting
from zarm_geometry.frames import matrix
from zarm_geometry.frames import pose_of as placed_at
from zarm_ros_bridge.convert.fields import finite
from zarm_ros_bridge.convert.joints import known_as
from zarm_ros_bridge.convert.poses import pose_of
from zarm_ros_bridge.convert.times import NANOSECONDS

Send = Callable[[Any], str | None]
"""Sends a target to a session; returns what of it is not followed, if the answer says so."""
LookUp = Callable[[Any, str], NDArray[np.float64] | None]
"""`look_up(header, field)`: the pose (4, 4) of the header's frame in the base frame, None if it is that; raises InvalidRequest."""

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


def twist_of(message: TwistStamped, robot: RobotDescriptor, look_up: LookUp) -> Send:
    """Velocities of the tip (m/s, rad/s) along the axes of the frame that `frame_id` names.

    Raises InvalidRequest for an unknown frame, and for values that are not finite.
    """
    linear, angular = (_vector(getattr(message.twist, name), f"twist.{name}") for name in ("linear", "angular"))
    frame: Literal["base", "tool"] = "base"
    if known_as(message.header.frame_id.removeprefix("/"), (robot.tip_link,)) == robot.tip_link:
        frame = "tool"
    elif (pose := look_up(message.header, "header")) is not None:
        linear, angular = _turned(pose, linear), _turned(pose, angular)

    def send(session: Jogging) -> None:
        session.twist(linear, angular, frame=frame)

    return send


def target_of(message: PoseStamped, robot: RobotDescriptor, look_up: LookUp) -> Send:
    """A pose of the tip in the frame of its header.

    Raises InvalidRequest for an unknown frame, for one that moves with the robot, from which the target would run away, and for an
    invalid pose.
    """
    links = {robot.base_link, robot.tip_link, *robot.collision}
    link = known_as(message.header.frame_id.removeprefix("/"), links)
    if link in links and link != robot.base_link:
        raise InvalidRequest(
            f"the frame {link} moves with the robot, and the target would run away; use {robot.base_link}",
            field="header.frame_id",
        )
    pose = pose_of(message.pose, "pose")
    if (frame := look_up(message.header, "header")) is not None:
        pose = placed_at(frame @ matrix(pose.position, pose.orientation))

    def send(session: Tracking) -> None:
        session.to(pose)

    return send


def joint_speed_of(message: Any, robot: RobotDescriptor, _: LookUp) -> Send:
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


def chunk_of(message: JointTrajectory, robot: RobotDescriptor, _: LookUp) -> Send:
    """A chunk of positions (rad), with velocities (rad/s) where every point has them. The stamp of the header is when it begins; 0 means now.

    Raises InvalidRequest for other joints than all of the robot's, and for values that are not finite.
    """
    joints, points = robot.joints, message.points
    names = [known_as(name, joints) for name in message.joint_names]
    if sorted(names) != sorted(joints):
        raise InvalidRequest(
            f"{', '.join(message.joint_names) or 'no joint'}; name each of {', '.join(joints)} once",
            field="joint_names",
        )
    order = [names.index(joint) for joint in joints]

    def rows(kind: str) -> list[list[float]]:
        found = []
        for i, point in enumerate(points):
            values = getattr(point, kind)
            if len(values) != len(names):
                raise InvalidRequest(f"{len(values)} values for {len(names)} joints", field=f"points[{i}].{kind}")
            found.append([finite(values[k], f"points[{i}].{kind}[{k}]") for k in order])
        return found

    positions = rows("positions")
    velocities = rows("velocities") if points and all(len(point.velocities) for point in points) else None
    times = [_seconds(point.time_from_start) for point in points]
    begins = _seconds(message.header.stamp)

    def send(session: ChunkTracking) -> str | None:
        over = session.follow(positions, times=times, start=begins or None, velocities=velocities).clipped
        return (
            "; ".join(f"the {one.quantity} of {one.joint} is {one.excess:.3g} over its limit" for one in over) or None
        )

    return send


def lasting(message: Any) -> float:
    """How long (s) a command leads the robot."""
    return (
        _seconds(message.points[-1].time_from_start) if isinstance(message, JointTrajectory) and message.points else 0.0
    )


def _seconds(time: Any) -> float:
    return float(time.sec + time.nanosec / NANOSECONDS)


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


def _turned(frame: NDArray[np.float64], vector: Vector3) -> Vector3:
    """A vector of a frame (4, 4) in the base frame."""
    x, y, z = (frame[:3, :3] @ np.array(vector)).tolist()
    return x, y, z


def _vector(message: Any, field: str) -> Vector3:
    x, y, z = (finite(getattr(message, axis), f"{field}.{axis}") for axis in "xyz")
    return x, y, z
