"""What a driver says and is sent on ROS, as messages of zarm and back."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence

from builtin_interfaces.msg import Duration
from sensor_msgs.msg import JointState as RosJointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import DriverCommand, JointState, Trajectory


def driver_joint_state(message: RosJointState, unnamed: tuple[str, ...], joints: tuple[str, ...]) -> JointState:
    """A driver's joint states: of `joints`, whatever others are there, or, without names, of `unnamed` by index.

    `joint1` is as good as `joint_1`: Doosan's drivers have had both. Velocities that are left out or not finite are 0, as
    some drivers know none. A stamp of 0 is now. Raises InvalidRequest, which names the field, for what cannot be read.
    """
    names = _names(message.name, joints) if message.name else unnamed
    position = _one_each(message.position, names, "position")
    velocity = _one_each(message.velocity, names, "velocity") if len(message.velocity) else {}
    told = tuple(name for name in names if name in joints)
    if not all(math.isfinite(position[name]) for name in told):
        raise InvalidRequest("a position is not finite; the driver must tell where each joint is", field="position")
    stamp = message.header.stamp
    return JointState(
        stamp=stamp.sec + stamp.nanosec * 1e-9 if stamp.sec or stamp.nanosec else time.time(),
        joint_names=told,
        position=tuple(position[name] for name in told),
        velocity=tuple(speed if math.isfinite(speed := velocity.get(name, 0.0)) else 0.0 for name in told),
    )


def ros_joint_trajectory(motion: DriverCommand | Trajectory) -> JointTrajectory:
    """A motion that begins when it arrives (stamp 0). A command without points is to stop."""
    points = []
    for index, at in enumerate(motion.time):
        point = JointTrajectoryPoint(
            positions=list(motion.position[index]),
            velocities=list(motion.velocity[index]) if motion.velocity else [],
            accelerations=list(motion.acceleration[index]) if motion.acceleration else [],
        )
        point.time_from_start = ros_duration(at)
        points.append(point)
    return JointTrajectory(joint_names=list(motion.joint_names), points=points)


def ros_duration(seconds: float) -> Duration:
    """Seconds as a duration of ROS, to the nanosecond."""
    nanoseconds = round(seconds * 1e9)
    return Duration(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)


def _names(told: Sequence[str], joints: tuple[str, ...]) -> tuple[str, ...]:
    plain = {joint.replace("_", ""): joint for joint in joints}
    names = tuple(name if name in joints else plain.get(name.replace("_", ""), name) for name in told)
    missing = [joint for joint in joints if joint not in names]
    if missing:
        raise InvalidRequest(
            f"{', '.join(missing)} missing among {', '.join(told)}; is it another robot?", field="name"
        )
    if len(set(names)) < len(names):
        raise InvalidRequest(f"a name stands twice among {', '.join(told)}", field="name")
    return names


def _one_each(values: Sequence[float], names: tuple[str, ...], field: str) -> dict[str, float]:
    if len(values) != len(names):
        raise InvalidRequest(f"{len(values)} values for {len(names)} joints", field=field)
    return dict(zip(names, values, strict=True))
