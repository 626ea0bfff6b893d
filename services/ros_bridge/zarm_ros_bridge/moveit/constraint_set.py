"""MoveIt's constraints on a state of the robot, and whether they hold."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from copy import copy
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from moveit_msgs.msg import MoveItErrorCodes as Val
from moveit_msgs.msg import OrientationConstraint
from shape_msgs.msg import SolidPrimitive

from zarm_contract.messages import Pose
from zarm_geometry.frames import matrix
from zarm_ros_bridge.convert.fields import finite
from zarm_ros_bridge.convert.joints import known_as
from zarm_ros_bridge.convert.poses import pose_of
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.frames import Frames
from zarm_ros_bridge.moveit.error_codes import Refusal
from zarm_trajectory.arrays import Array

FREE = 3.1
"""Tolerance (rad) from which a component of an orientation is free; MoveIt's users write 3.14 or more."""
_SLACK = 1e-9


@dataclass(frozen=True)
class JointBounds:
    """A joint is from `low` to `high` (rad), and at `position` at best."""

    joint: str
    position: float
    low: float
    high: float


@dataclass(frozen=True)
class PointRegion:
    """The point `offset` (m) of a link is in a shape whose pose in the base frame is `pose` (4, 4).

    `half` (m) are half the edges of a box; with `radius` it is a ball.
    """

    link: str
    offset: tuple[float, float, float]
    pose: Array
    half: tuple[float, float, float] | None
    radius: float | None


@dataclass(frozen=True)
class Orientation:
    """A link is turned as `rotation` (3, 3) in the base frame, to within `tolerance` (rad) about each axis of that frame.

    The tolerances are of a rotation vector, or with `euler` of intrinsic angles about x, y and z.
    """

    link: str
    rotation: Array
    tolerance: tuple[float, float, float]
    euler: bool


class ConstraintSet:
    """One `moveit_msgs/Constraints`, with everything in the base frame. Raises Refusal for what zarm has no meaning for."""

    def __init__(self, message: Any, engine: Engine, frames: Frames, field: str) -> None:
        self._frames = frames
        if message.visibility_constraints:
            raise Refusal(
                Val.INVALID_GOAL_CONSTRAINTS,
                "visibility is not constrained by zarm; leave it out",
                f"{field}.visibility_constraints",
            )
        self.joints = tuple(
            _joint(one, engine, f"{field}.joint_constraints[{i}]") for i, one in enumerate(message.joint_constraints)
        )
        self.positions = tuple(
            self._position(one, f"{field}.position_constraints[{i}]")
            for i, one in enumerate(message.position_constraints)
        )
        self.orientations = tuple(
            self._orientation(one, f"{field}.orientation_constraints[{i}]")
            for i, one in enumerate(message.orientation_constraints)
        )
        self._names = engine.joints

    def __bool__(self) -> bool:
        return bool(self.joints or self.positions or self.orientations)

    @property
    def links(self) -> tuple[str, ...]:
        """The links whose pose is constrained, each once."""
        placed: tuple[PointRegion | Orientation, ...] = (*self.positions, *self.orientations)
        return tuple(dict.fromkeys(one.link for one in placed))

    def of(self, links: Collection[str]) -> Self:
        """The constraints on the poses of these links alone."""
        part = copy(self)
        part.joints = ()
        part.positions = tuple(one for one in self.positions if one.link in links)
        part.orientations = tuple(one for one in self.orientations if one.link in links)
        return part

    def evaluate(self, position: Sequence[float]) -> Iterator[tuple[bool, float]]:
        """For each constraint, those of joints first, whether it holds at these joints (rad), and how far off they are
        (rad, m).
        """
        values = dict(zip(self._names, position, strict=True))
        for bounds in self.joints:
            value = values[bounds.joint]
            yield bounds.low - _SLACK <= value <= bounds.high + _SLACK, abs(value - bounds.position)
        links = self._frames.links.poses(position) if self.positions or self.orientations else {}
        for region in self.positions:
            point = links[region.link] @ np.append(region.offset, 1.0)
            inside = np.linalg.inv(region.pose) @ point
            distance = float(np.linalg.norm(inside[:3]))
            if region.half is None:
                yield distance <= (region.radius or 0.0) + _SLACK, distance
            else:
                yield bool(np.all(np.abs(inside[:3]) <= np.array(region.half) + _SLACK)), distance
        for orientation in self.orientations:
            angles = deviation(orientation, links[orientation.link][:3, :3])
            holds = all(
                angle <= most + _SLACK for angle, most in zip(angles, orientation.tolerance, strict=True) if most < FREE
            )
            yield holds, sum(angles) / 3.0

    def holds(self, position: Sequence[float]) -> bool:
        """Whether all hold at these joints (rad)."""
        return all(holds for holds, _ in self.evaluate(position))

    def _link(self, name: str, field: str) -> str:
        link = known_as(name, self._frames.links.links)
        if link not in self._frames.links.links:
            raise Refusal(
                Val.INVALID_LINK_NAME,
                f"the robot has no link {name!r}; choose among {', '.join(self._frames.links.links)}",
                f"{field}.link_name",
            )
        return link

    def _position(self, message: Any, field: str) -> PointRegion:
        region, offset = message.constraint_region, message.target_point_offset
        if region.meshes or len(region.primitives) != 1 or len(region.primitive_poses) != 1:
            raise Refusal(
                Val.INVALID_GOAL_CONSTRAINTS,
                "a region is one primitive with one pose; give a sphere or a box, and alternatives as further constraints",
                f"{field}.constraint_region",
            )
        pose = self._frames.in_base(
            pose_of(region.primitive_poses[0], f"{field}.constraint_region.primitive_poses[0]"),
            message.header,
            f"{field}.header",
        )
        half, radius = _shape(region.primitives[0], f"{field}.constraint_region.primitives[0]")
        at = (offset.x, offset.y, offset.z)
        for axis, value in zip("xyz", at, strict=True):
            finite(value, f"{field}.target_point_offset.{axis}")
        return PointRegion(
            self._link(message.link_name, field), at, matrix(pose.position, pose.orientation), half, radius
        )

    def _orientation(self, message: Any, field: str) -> Orientation:
        q = message.orientation
        if not any((q.x, q.y, q.z, q.w)):
            raise Refusal(
                Val.INVALID_GOAL_CONSTRAINTS, "the quaternion is 0; give one of length 1", f"{field}.orientation"
            )
        length = math.hypot(q.x, q.y, q.z, q.w)
        if not abs(length - 1.0) <= 1e-3:  # NaN too
            raise Refusal(
                Val.INVALID_GOAL_CONSTRAINTS,
                f"the quaternion (x, y, z, w) has the length {length:.6g}; normalise it to 1",
                f"{field}.orientation",
            )
        turned = Pose(position=(0.0, 0.0, 0.0), orientation=(q.x, q.y, q.z, q.w))
        pose = self._frames.in_base(turned, message.header, f"{field}.header")
        x, y, z = (
            abs(finite(getattr(message, f"absolute_{axis}_axis_tolerance"), f"{field}.absolute_{axis}_axis_tolerance"))
            for axis in "xyz"
        )
        return Orientation(
            self._link(message.link_name, field),
            matrix(pose.position, pose.orientation)[:3, :3],
            (x, y, z),
            message.parameterization != OrientationConstraint.ROTATION_VECTOR,
        )


def deviation(orientation: Orientation, rotation: Array) -> tuple[float, float, float]:
    """The absolute angles (rad) by which a link with this rotation (3, 3) deviates, as MoveIt's kinematic constraints measure
    them.
    """
    off = orientation.rotation.T @ rotation
    if orientation.euler:  # R = Rx(a) Ry(b) Rz(c)
        b = math.asin(min(max(float(off[0, 2]), -1.0), 1.0))
        if abs(off[0, 2]) > 1.0 - 1e-9:
            a, c = 0.0, math.atan2(off[1, 0], off[1, 1])
        else:
            a, c = math.atan2(-off[1, 2], off[2, 2]), math.atan2(-off[0, 1], off[0, 0])
        return abs(a), abs(b), abs(c)
    angle = math.acos(min(max((float(np.trace(off)) - 1.0) / 2.0, -1.0), 1.0))
    axis = np.array([off[2, 1] - off[1, 2], off[0, 2] - off[2, 0], off[1, 0] - off[0, 1]])
    length = float(np.linalg.norm(axis))
    if length < 1e-12:
        values, vectors = np.linalg.eigh((off + off.T) / 2.0)
        axis, length = vectors[:, int(np.argmax(values))], 1.0
    x, y, z = np.abs(axis / length * angle).tolist()
    return x, y, z


def _joint(message: Any, engine: Engine, field: str) -> JointBounds:
    joint = known_as(message.joint_name, engine.joints)
    if joint not in engine.joints:
        raise Refusal(
            Val.INVALID_GOAL_CONSTRAINTS,
            f"the robot has no joint {message.joint_name!r}; choose among {', '.join(engine.joints)}",
            f"{field}.joint_name",
        )
    position = finite(message.position, f"{field}.position")
    above, below = (
        finite(getattr(message, name), f"{field}.{name}") for name in ("tolerance_above", "tolerance_below")
    )
    if above < 0.0 or below < 0.0:
        raise Refusal(Val.INVALID_GOAL_CONSTRAINTS, "a tolerance is negative; give one from 0", field)
    return JointBounds(joint, position, position - below, position + above)


def _shape(primitive: Any, field: str) -> tuple[tuple[float, float, float] | None, float | None]:
    sizes = [finite(size, f"{field}.dimensions[{i}]") for i, size in enumerate(primitive.dimensions)]
    if primitive.type == SolidPrimitive.BOX and len(sizes) == 3 and min(sizes) >= 0.0:
        return (sizes[0] / 2.0, sizes[1] / 2.0, sizes[2] / 2.0), None
    if primitive.type == SolidPrimitive.SPHERE and len(sizes) == 1 and sizes[0] >= 0.0:
        return None, sizes[0]
    raise Refusal(
        Val.INVALID_GOAL_CONSTRAINTS,
        f"a region is a SPHERE with a radius or a BOX with three edges, and not the type {primitive.type} with {len(sizes)} "
        "dimensions",
        field,
    )
