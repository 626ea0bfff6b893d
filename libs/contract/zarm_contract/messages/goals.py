"""Goals of plans: poses with their freedom, joints, waypoints, and curves of the tip."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Discriminator, Field, Tag, ValidationInfo, field_validator

from zarm_contract._model import Message
from zarm_contract.messages.motion import Joints, Name, Pose, Quaternion, Vector3

Free = Annotated[Literal["free"], Tag("keyword")]
"""A component of a pose that may have any value."""
_BoundOrKeyword = Discriminator(lambda bound: "keyword" if isinstance(bound, str) else "bound")
DistanceTolerance = Annotated[Annotated[float, Field(ge=0, le=100), Tag("bound")] | Free, _BoundOrKeyword]
AngleTolerance = Annotated[Annotated[float, Field(ge=0, le=math.pi), Tag("bound")] | Free, _BoundOrKeyword]


class PoseTolerance(Message):
    """How far the tip may be from the pose of a goal: each component by a number from 0, or `"free"`.

    `orientation` (rad) bounds the components `[theta_x, theta_y, theta_z]` of the rotation vector from the goal's orientation to the
    tip's, in the goal's frame. `position` (m) bounds `[x, y, z]` along the axes of `frame`: the base's, or with `tool` the
    goal's. With `radius` (m) the tip is inside a ball instead of that box.
    """

    orientation: tuple[AngleTolerance, AngleTolerance, AngleTolerance] = (0.0, 0.0, 0.0)
    position: tuple[DistanceTolerance, DistanceTolerance, DistanceTolerance] = (0.0, 0.0, 0.0)
    radius: Annotated[float, Field(gt=0, le=100)] | None = None
    frame: Literal["base", "tool"] = "tool"

    @field_validator("radius")
    @classmethod
    def _box_or_ball(cls, radius: float | None, info: ValidationInfo) -> float | None:
        if radius is not None and any(info.data.get("position", ())):
            raise ValueError("position bounds a box already; give one of them")
        return radius

    @property
    def bounds(self) -> tuple[float, ...]:
        """The bounds `[theta_x, theta_y, theta_z, x, y, z, distance]` in rad and m, infinite where free."""
        position = self.position if self.radius is None else ("free", "free", "free")
        radius = math.inf if self.radius is None else self.radius
        return (*(math.inf if bound == "free" else bound for bound in (*self.orientation, *position)), radius)


class TipFrame(Message):
    """A frame of the robot: `offset` as seen from `link`, which is a link of the URDF or an attached object."""

    link: Annotated[str, Field(min_length=1, max_length=128)]
    offset: Pose = Pose(position=(0.0, 0.0, 0.0))


class Offset(Message):
    """A straight way of `distance` (m) along `direction`, which need not have length 1, in the frame of the tip or the base.

    On it, and at its end, the robot may touch the objects named in `touch`.
    """

    distance: Annotated[float, Field(gt=0, le=2)]
    direction: Vector3
    frame: Literal["base", "tool"] = "tool"
    touch: tuple[Name, ...] = Field(default=(), max_length=32)

    @field_validator("direction")
    @classmethod
    def _has_length(cls, direction: Vector3) -> Vector3:
        if math.hypot(*direction) < 1e-6:
            raise ValueError("a direction has a length; give one such as [0, 0, 1]")
        return direction


class PoseGoal(Message):
    """Move the tip to a pose in the base frame: `position` (m), `orientation` `[x, y, z, w]`.

    With `alternatives` it is a goal set: the plan leads to the pose that is reached in the shortest time. With a `tolerance` any pose
    within it is a goal, and the plan leads to one that is reached soon. `tip` names another frame than the descriptor's `tip_link`.
    The last of the way there is straight along `approach`, and the way on, after a rest at the pose, straight along `retreat`, both with
    the tip's speed of the descriptor.
    """

    kind: Literal["pose"]
    position: Vector3
    orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    alternatives: tuple[Pose, ...] = Field(default=(), max_length=63)
    tolerance: PoseTolerance | None = None
    tip: TipFrame | None = None
    approach: Offset | None = None
    retreat: Offset | None = None

    @property
    def has_freedom(self) -> bool:
        """Whether it allows more than one pose of the tip, or is a goal of another frame."""
        return self.tolerance is not None or self.tip is not None

    @property
    def poses(self) -> tuple[Pose, ...]:
        """All poses of the set: its own, then the alternatives."""
        return (Pose(position=self.position, orientation=self.orientation), *self.alternatives)


class JointGoal(Message):
    """Move the joints to `position` (rad)."""

    kind: Literal["joints"]
    position: Joints


class WaypointsGoal(Message):
    """Move through poses and joint positions in this order without stopping, and rest at the last.

    At each waypoint the tip is within `position_tolerance` (m) and `angle_tolerance` (rad) of it.
    """

    kind: Literal["waypoints"]
    through: tuple[Annotated[PoseGoal | JointGoal, Field(discriminator="kind")], ...] = Field(
        min_length=1, max_length=100
    )
    position_tolerance: Annotated[float, Field(ge=0.0005, le=0.1)] = 0.005
    angle_tolerance: Annotated[float, Field(ge=0.001, le=0.5)] = 0.02


class ToolPathGoal(Message):
    """What `line`, `arc` and `path` have in common: the tip moves from where it is along a curve that is given.

    Along it the tip deviates by at most 0.1 mm and 0.1 deg. It moves with `speed` (m/s) and turns with `rotational_speed` (rad/s)
    at most, keeps the one that takes longer wherever the joints allow, and changes them by at most `acceleration` (m/s²) and its
    equivalent for turning, the one that brings it to its rotational speed in the same time; by default as in the descriptor's `tool`. The
    orientation is `interpolated` between those of the points, `fixed` as at the start, or turns with the `tangent` of the curve. It may be off by
    `orientation_tolerance` (rad, by axis of the tip, from 0 to `"free"`) as in `PoseTolerance`. `tip` names another frame than the
    descriptor's `tip_link`.
    """

    speed: Annotated[float, Field(gt=0, le=20)] | None = None
    acceleration: Annotated[float, Field(gt=0, le=200)] | None = None
    rotational_speed: Annotated[float, Field(gt=0, le=50)] | None = None
    orienting: Literal["interpolated", "fixed", "tangent"] = "interpolated"
    orientation_tolerance: tuple[AngleTolerance, AngleTolerance, AngleTolerance] = (0.0, 0.0, 0.0)
    tip: TipFrame | None = None


class LineGoal(ToolPathGoal):
    """Move the tip on a straight line to `position` (m) in the base frame; without an `orientation` it keeps its own."""

    kind: Literal["line"]
    position: Vector3
    orientation: Quaternion | None = None


class ArcGoal(ToolPathGoal):
    """Move the tip on a circular arc to `position` (m) in the base frame; without an `orientation` it keeps its own.

    The arc leads through the point `via` (m), or around `center` (m), then the shorter way. Give one of them. An arc that ends where it
    starts is a full circle around `center`, on which `via` comes first: give both.
    """

    kind: Literal["arc"]
    position: Vector3
    orientation: Quaternion | None = None
    via: Vector3 | None = None
    center: Vector3 | None = None


Blend = Annotated[float, Field(ge=0, le=10)]


class PathPoint(Message):
    """A point of a path: `position` (m) in the base frame; without an `orientation` the tip keeps that of the point before.

    With `via` or `center` (m) the tip moves to it on an arc, as with an `ArcGoal`. `blend` (m) is that of this corner, in place of the path's.
    """

    position: Vector3
    orientation: Quaternion | None = None
    blend: Blend | None = None
    via: Vector3 | None = None
    center: Vector3 | None = None


class PathGoal(ToolPathGoal):
    """Move the tip through `points`: on lines and arcs whose corners are rounded, or with `shape` `spline` on a smooth curve.

    A corner is left at most `blend` (m) before and after its point, by default 0.01 m or 0.4 of the shorter line or arc. With `blend` 0 the
    tip comes to rest there.
    """

    kind: Literal["path"]
    points: tuple[PathPoint, ...] = Field(min_length=1, max_length=1000)
    shape: Literal["polyline", "spline"] = "polyline"
    blend: Blend | None = None


GroupName = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_+]{0,63}$")]
"""A joint group of the descriptor."""


class PathConstraint(Message):
    """A path constraint: components of the tip pose that stay as at the start, `[theta_x, theta_y, theta_z, x, y, z]`.

    With `frame` `base` these are the position and the rotation vector from the start orientation, both in the base frame. With
    `tool` they are the pose relative to the tip pose at the start. The tolerances are in m and rad.

    The tip is that of `group`, by default of the group that moves. With `relative_to` its pose is that in the frame of the tip of this
    other group, in place of the base frame: two arms that hold one object keep all six components. If the goal moves only the
    other group, `group` follows.
    """

    axes: tuple[bool, bool, bool, bool, bool, bool]
    frame: Literal["base", "tool"] = "base"
    position_tolerance: Annotated[float, Field(ge=0.0005, le=0.1)] = 0.005
    angle_tolerance: Annotated[float, Field(ge=0.001, le=0.5)] = 0.02
    group: GroupName | None = None
    relative_to: GroupName | None = None


class GroupGoal(Message):
    """The goal of one group: a pose of its tip, or its joints."""

    group: GroupName
    goal: Annotated[PoseGoal | JointGoal, Field(discriminator="kind")]


class GroupsGoal(Message):
    """Move several groups at once, each to its own goal: both arms, for example. They start and arrive together, and no two may share a
    joint. The other joints stand.
    """

    kind: Literal["groups"]
    goals: tuple[GroupGoal, ...] = Field(min_length=1, max_length=8)


CartesianGoal = LineGoal | ArcGoal | PathGoal
"""A goal that says along which curve the tip moves."""
Goal = Annotated[PoseGoal | JointGoal | WaypointsGoal | CartesianGoal | GroupsGoal, Field(discriminator="kind")]
