"""The goals typed for `plan`, `execute`, `ik` and `track`: poses with freedom, curves of the tip, joints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import typer

from zarm.motions import tolerance_of
from zarm.robot import Robot
from zarm.values import AXES, IDENTITY
from zarm_cli.client import floats, joints
from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import PoseTolerance

To = Annotated[
    list[str] | None,
    typer.Option(
        metavar="X,Y,Z[,QX,QY,QZ,QW]",
        help="Pose of the tip in the base frame (m). Without an orientation the tip keeps its own. "
        "Given several times: one motion through all of them in this order, without stopping. "
        "With GROUP= in front, a pose for each group: both arms move together.",
    ),
]
AnyOf = Annotated[bool, typer.Option("--any", help="Of several --to, go to the one that takes the least time.")]
Free = Annotated[
    str | None,
    typer.Option(metavar="AXIS,...", help=f"Components of --to that may have any value: {', '.join(AXES)}."),
]
Tolerance = Annotated[
    str | None,
    typer.Option(
        metavar="AXIS=VALUE,...",
        help="How far components of --to may be off (rad, m): theta_x=0.1,z=0.01. Or `radius` (m): anywhere in a ball.",
    ),
]
ToleranceFrame = Annotated[
    Literal["base", "tool"] | None,
    typer.Option(help="Axes of x, y and z in --free and --tolerance (default: tool, those of the goal)."),
]
Tip = Annotated[
    str | None, typer.Option(metavar="LINK", help="Link or attached object to bring to --to (default: the tip).")
]
AsLine = Annotated[
    bool,
    typer.Option("--line", help="Go to --to on a straight line; through several on lines with rounded corners."),
]
Spline = Annotated[bool, typer.Option("--spline", help="Go through all --to on a smooth curve.")]
Via = Annotated[str | None, typer.Option(metavar="X,Y,Z", help="Go to --to on a circular arc through this point (m).")]
Center = Annotated[
    str | None, typer.Option(metavar="X,Y,Z", help="Go to --to on a circular arc around this point (m).")
]
Blend = Annotated[
    float | None,
    typer.Option(help="How far before and after a corner it may be left (m; default: 0.01). 0: stop there."),
]
ToolSpeed = Annotated[float | None, typer.Option(help="Speed of the tip along a line, an arc or a path (m/s).")]
ToolAcceleration = Annotated[float | None, typer.Option(help="Its acceleration (m/s^2).")]
RotationalSpeed = Annotated[float | None, typer.Option(help="Speed at which the tip turns there (rad/s).")]
Orienting = Annotated[
    Literal["interpolated", "fixed", "tangent"] | None,
    typer.Option(help="How the tip turns along a line, an arc or a path (default: interpolated)."),
]
Group = Annotated[
    str | None, typer.Option(help="Joint group that moves, of a robot with several arms; the other joints stand.")
]
JointsGoal = Annotated[
    str | None, typer.Option("--joints", metavar="A,B,C,...", help="Joint positions (rad), in the descriptor's order.")
]


@dataclass(frozen=True)
class Freedom:
    """What typed poses leave open: their tolerance, and the frame that is brought there."""

    tolerance: PoseTolerance | None = None
    tip: str | None = None

    @property
    def needs_orientation(self) -> bool:
        """Whether the orientation of a typed pose matters."""
        return self.tolerance is None or self.tolerance.orientation != ("free", "free", "free")

    @property
    def fields(self) -> dict[str, object]:
        """The fields of a goal or of an `IkRequest`."""
        tolerance = None if self.tolerance is None else self.tolerance.model_dump(exclude_none=True)
        return {"tolerance": tolerance, "tip": None if self.tip is None else {"link": self.tip}}


EXACT = Freedom()
"""No freedom at all."""


def typed_freedom(
    free: str | None, tolerance: str | None, frame: Literal["base", "tool"] | None, tip: str | None
) -> Freedom:
    """Read --free, --tolerance, --tolerance-frame and --tip; usage error for an unknown axis or value."""
    bounds: dict[str, float] = {}
    for part in tolerance.split(",") if tolerance else ():
        axis, _, value = part.partition("=")
        (bounds[axis],) = floats(value, "--tolerance", 1)
    radius = bounds.pop("radius", None)
    try:
        allowed = tolerance_of(free.split(",") if free else (), bounds, radius, frame or "tool")
    except InvalidRequest as error:
        hint = "--free" if error.problem.field == "free" else "--tolerance"
        raise typer.BadParameter(error.problem.message, param_hint=hint) from None
    if frame is not None and allowed is None:
        raise typer.BadParameter("belongs to --free or --tolerance", param_hint="--tolerance-frame")
    return Freedom(allowed, tip)


@dataclass(frozen=True)
class Curve:
    """On which curve the tip moves: the `kind` of a goal, and its other fields without those that are None."""

    kind: Literal["line", "arc", "path"]
    fields: dict[str, object]


def typed_curve(
    *, line: bool, spline: bool, via: str | None, center: str | None, blend: float | None, **motion: object
) -> Curve | None:
    """Read --line, --spline, --via, --center, --blend and how fast the tip moves; usage error if they do not go together."""
    asked = {"--line": line, "--spline": spline, "--via": via is not None, "--center": center is not None}
    names = [name for name, given in asked.items() if given]
    fields = {name: value for name, value in motion.items() if value is not None}
    if not names and blend is None and not fields:
        return None
    if len(names) != 1 and names != ["--via", "--center"]:  # both of a full circle
        raise typer.BadParameter("give exactly one of them", param_hint=" / ".join(asked))
    if blend is not None and not line:
        raise typer.BadParameter("belongs to --line", param_hint="--blend")
    if line:
        return Curve("line", {**fields, "blend": blend})
    if spline:
        return Curve("path", {**fields, "shape": "spline"})
    arc = {"via": via and floats(via, "--via", 3), "center": center and floats(center, "--center", 3)}
    return Curve("arc", {**fields, **{name: value for name, value in arc.items() if value is not None}})


@dataclass(frozen=True)
class TypedGoal:
    """A typed goal: joints (rad), or tip poses whose orientation is optional.

    With `any_of` the motion goes to one of the poses, otherwise through all; with a `curve` along that. `groups` are those of
    the poses, if each is for a group of its own.
    """

    joints: list[float] | None
    poses: list[list[float]]
    any_of: bool
    freedom: Freedom
    curve: Curve | None = None
    groups: tuple[str, ...] = ()


def typed_goal(
    to: list[str] | None, joints_goal: str | None, any_of: bool, freedom: Freedom = EXACT, curve: Curve | None = None
) -> TypedGoal:
    """Read --to and --joints, one of which must be given, --any, the freedom and the curve; usage error otherwise."""
    if bool(to) == (joints_goal is not None):
        raise typer.BadParameter("give exactly one of them", param_hint="--to / --joints")
    if any_of and not to:
        raise typer.BadParameter("belongs to --to", param_hint="--any")
    if freedom != EXACT and not to:
        raise typer.BadParameter("belong to --to", param_hint="--free / --tolerance / --tip")
    if curve is not None and (any_of or not to):
        raise typer.BadParameter("belong to --to without --any", param_hint="--line / --spline / --via / --center")
    groups = tuple(pose.partition("=")[0] for pose in to or () if "=" in pose)
    if groups and (any_of or curve is not None or len(groups) != len(to or ())):
        raise typer.BadParameter("with a group in front of one, every pose has its own", param_hint="--to")
    poses = [floats(pose.rpartition("=")[2], "--to", 3, 7) for pose in to or []]
    return TypedGoal(joints(joints_goal, "--joints"), poses, any_of, freedom, curve, groups)


def goal_fields(robot: Robot, typed: TypedGoal, start: list[float] | None, group: str | None) -> dict[str, object]:
    """The fields of the message of a goal, of a `group` or of the robot. Raises InvalidRequest for freedom that a curve does
    not allow.
    """
    if typed.joints is not None:
        return {"kind": "joints", "position": typed.joints}
    freedom = typed.freedom
    if typed.curve is not None:
        return _along(typed.curve, typed.poses, freedom)
    tips = typed.groups or (group,) * len(typed.poses)
    poses = [
        full_pose(robot, pose, start, oriented=freedom.needs_orientation, group=tip)
        for pose, tip in zip(typed.poses, tips, strict=True)
    ]
    if typed.groups:
        goals = zip(typed.groups, poses, strict=True)
        return {
            "kind": "groups",
            "goals": [{"group": one, "goal": {"kind": "pose", **pose, **freedom.fields}} for one, pose in goals],
        }
    if typed.any_of or len(poses) == 1:
        return {"kind": "pose", **poses[0], "alternatives": poses[1:], **freedom.fields}
    return {"kind": "waypoints", "through": [{"kind": "pose", **pose, **freedom.fields} for pose in poses]}


def full_pose(
    robot: Robot,
    typed: list[float],
    at: list[float] | None = None,
    *,
    oriented: bool = True,
    group: str | None = None,
) -> dict[str, list[float]]:
    """Position and orientation of a typed pose; by default the orientation is the tip's, of the `group`, at the joints `at`, or
    measured, if it is to be `oriented` at all.
    """
    if len(typed) == 3 and not oriented:
        typed = [*typed, *IDENTITY]
    if len(typed) == 3:
        typed = [*typed, *(robot.tip(group) if at is None else robot.fk([at], group=group)[0]).orientation]
    return {"position": typed[:3], "orientation": typed[3:]}


def _along(curve: Curve, poses: list[list[float]], freedom: Freedom) -> dict[str, object]:
    """The fields of a line, an arc or a path; points without an orientation keep that of the tip."""
    points = [{"position": pose[:3], "orientation": pose[3:] or None} for pose in poses]
    fields = {**curve.fields, "tip": freedom.fields["tip"]}
    if freedom.tolerance is not None:
        if freedom.tolerance != PoseTolerance(orientation=freedom.tolerance.orientation):
            raise InvalidRequest(
                "along a curve only theta_x, theta_y and theta_z may be free or off", field="tolerance"
            )
        fields["orientation_tolerance"] = freedom.tolerance.orientation
    if curve.kind == "path" or len(points) > 1:
        if curve.kind == "arc":
            raise InvalidRequest("an arc leads to one point; give one --to", field="to")
        return {"kind": "path", "points": points, **fields}
    fields.pop("blend", None)  # a single line has no corner
    return {"kind": curve.kind, **points[0], **fields}
