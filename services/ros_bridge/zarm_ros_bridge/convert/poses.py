"""Poses."""

from __future__ import annotations

import math

from geometry_msgs.msg import Point, Quaternion
from geometry_msgs.msg import Pose as RosPose

from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import Pose
from zarm_ros_bridge.convert.fields import finite

UNIT = 1e-3
"""How far the norm of a quaternion may be from 1, as in the contract; it is normalised."""


def ros_pose(pose: Pose) -> RosPose:
    """A pose."""
    (px, py, pz), (x, y, z, w) = pose.position, pose.orientation
    return RosPose(position=Point(x=px, y=py, z=pz), orientation=Quaternion(x=x, y=y, z=z, w=w))


def pose_of(message: RosPose, field: str) -> Pose:
    """The pose in a request's `field`. An orientation of `{0, 0, 0, 0}` means none, as is usual in ROS.

    Raises InvalidRequest for values that are not finite, and for a quaternion whose norm differs from 1 by more than
    UNIT.
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
            f"the quaternion (x, y, z, w) has the length {length:.6g}; normalise it to 1, or leave all four at 0 for no rotation",
            field=f"{field}.orientation",
        )
    return Pose(position=position, orientation=orientation)


def is_given(message: RosPose) -> bool:
    """Whether a client filled in this pose: the default is at the origin, unrotated, inside the robot's base."""
    p, q = message.position, message.orientation
    return any((p.x, p.y, p.z, q.x, q.y, q.z)) or q.w not in (0.0, 1.0)
