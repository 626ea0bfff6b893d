"""Messages of zarm as messages of ROS, and back: times, poses, joints.

What comes from ROS is checked here, and refused by an InvalidRequest that names the field as ROS knows it. Units are the same
on both sides (m, rad, s), and so is the order of a quaternion: x, y, z, w.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterable, Mapping, Sequence

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Quaternion
from geometry_msgs.msg import Pose as RosPose
from sensor_msgs.msg import JointState as RosJointState

from zarm_contract.errors import InvalidRequest, ZarmError, from_problem
from zarm_contract.messages import JointState, Pose

Positions = tuple[float, ...]
"""One per joint, in the descriptor's order; rad."""

UNIT = 1e-3
"""How far the length of a quaternion may be from 1; it is normalised. The contract's own bound."""


def ros_time(stamp: float) -> Time:
    """Unix seconds as the time of ROS, to the nanosecond that a double can tell."""
    nanoseconds = round(stamp * 1e9)
    return Time(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)


def ros_joint_state(state: JointState) -> RosJointState:
    """Measured or previewed joints."""
    message = ros_positions(state.joint_names, state.position, state.velocity)
    message.header.stamp = ros_time(state.stamp)
    return message


def ros_positions(joints: Sequence[str], position: Iterable[float], velocity: Iterable[float] = ()) -> RosJointState:
    """Joints without a time."""
    return RosJointState(name=list(joints), position=array("d", position), velocity=array("d", velocity))


def ros_pose(pose: Pose) -> RosPose:
    """A pose."""
    (px, py, pz), (x, y, z, w) = pose.position, pose.orientation
    return RosPose(position=Point(x=px, y=py, z=pz), orientation=Quaternion(x=x, y=y, z=z, w=w))


def pose_of(message: RosPose, field: str) -> Pose:
    """The pose in a request's `field`. An orientation left at `{0, 0, 0, 0}` is none, as everywhere in ROS.

    Raises InvalidRequest for what is no number, and for a quaternion whose length is further than UNIT from 1.
    """
    p, q = message.position, message.orientation
    position, orientation = (p.x, p.y, p.z), (q.x, q.y, q.z, q.w)
    for name, value in zip("xyz", position, strict=True):
        finite(value, f"{field}.position.{name}")
    for name, value in zip("xyzw", orientation, strict=True):
        finite(value, f"{field}.orientation.{name}")
    if not any(orientation):
        return Pose(position=position)
    length = math.hypot(*orientation)
    if abs(length - 1.0) > UNIT:
        raise InvalidRequest(
            f"the quaternion (x, y, z, w) has the length {length:.6g}; normalise it to 1, or leave all four at 0 for no turn",
            field=f"{field}.orientation",
        )
    return Pose(position=position, orientation=orientation)


def is_given(message: RosPose) -> bool:
    """Whether a client filled in this pose: at its defaults it is at the origin and not turned, inside the robot's base."""
    p, q = message.position, message.orientation
    return any((p.x, p.y, p.z, q.x, q.y, q.z)) or q.w not in (0.0, 1.0)


def positions_of(message: RosJointState, joints: Sequence[str], field: str) -> Positions:
    """The positions in a request's `field`, in the order of `joints`.

    By name, whatever other joints the message has (a gripper's, for one); without names, by index. `joint1` is as good as
    `joint_1`: Doosan's drivers have had both. Raises InvalidRequest for what fits neither and for what is no number.
    """
    values = list(message.position)
    if not message.name:
        if len(values) != len(joints):
            raise InvalidRequest(
                f"{len(values)} positions without names for the {len(joints)} joints {', '.join(joints)}; give one for each",
                field=f"{field}.position",
            )
        index = dict(zip(joints, range(len(joints)), strict=True))
    else:
        if len(values) != len(message.name):
            raise InvalidRequest(
                f"{len(values)} positions for {len(message.name)} names; give one for each", field=f"{field}.position"
            )
        index = _places(message.name, joints, f"{field}.name")
    for joint in joints:
        finite(values[index[joint]], f"{field}.position.{index[joint]}")
    return tuple(values[index[joint]] for joint in joints)


def is_empty(message: RosJointState) -> bool:
    """Whether a client left these joints out."""
    return not message.name and not len(message.position)


def finite(value: float, field: str) -> float:
    """The number itself. Raises InvalidRequest where it is NaN or infinite."""
    if not math.isfinite(value):
        raise InvalidRequest(f"{value} is no finite number; give one", field=field)
    return value


def in_terms_of(error: ZarmError, fields: Mapping[str, str]) -> ZarmError:
    """The same error with its field as the client on ROS knows it; `fields` are those of the bus, or beginnings of them."""
    at = error.problem.field or ""
    for known, name in fields.items():
        if at == known or at.startswith(f"{known}."):
            return from_problem(error.problem.model_copy(update={"field": name + at.removeprefix(known)}))
    return error


def _places(names: Sequence[str], joints: Sequence[str], field: str) -> dict[str, int]:
    """Where each of `joints` stands in `names`."""
    alike = {_plain(joint): joint for joint in joints}
    index: dict[str, int] = {}
    for place, name in enumerate(names):
        joint = name if name in joints else alike.get(_plain(name), name)
        if joint in index:
            raise InvalidRequest(f"the joint {name} stands twice; name each joint once", field=f"{field}.{place}")
        index[joint] = place
    missing = [joint for joint in joints if joint not in index]
    if missing:
        raise InvalidRequest(
            f"{', '.join(missing)} missing among {', '.join(names)}; name each of {', '.join(joints)}, or leave the names out "
            "and give the positions in this order",
            field=field,
        )
    return index


def _plain(name: str) -> str:
    return name.replace("_", "")
