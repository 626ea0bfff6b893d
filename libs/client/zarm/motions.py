"""Goals of plans, and segments of programs, made as the values of `zarm.values` are."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Literal, TypeAlias, TypedDict, Unpack

from pydantic import ValidationError

from zarm.values import AXES, Axis, Checked, Pose, invalid, made, numbers
from zarm_contract import messages
from zarm_contract.errors import InvalidRequest

if TYPE_CHECKING:
    from zarm.values import Numbers


class AnyOf(Checked, messages.PoseGoal):
    """A goal set: whichever of several tip poses is reached in the shortest time. `AnyOf(a, b, c)`, up to 64 poses.

    `plan.selected_goal_index` says which one was chosen, from 0.
    """

    def __init__(self, pose: messages.Pose, *alternatives: messages.Pose) -> None:
        super().__init__(
            kind="pose",
            position=pose.position,
            orientation=pose.orientation,
            alternatives=tuple(
                messages.Pose(position=other.position, orientation=other.orientation) for other in alternatives
            ),
        )


class PoseGoal(Checked, messages.PoseGoal):
    """A pose of the tip with freedom: `PoseGoal(pose, free=["theta_z"])`. Only a position, `PoseGoal((x, y, z))`, leaves the
    orientation free.

    The components `theta_x`, `theta_y`, `theta_z` of the rotation vector from the goal's orientation are measured in the goal's frame;
    `x`, `y` and `z` in `frame`: `tool`, the goal's, or `base`. Those that are `free` may have any value, others may be off by
    the `tolerance`, {"theta_x": 0.1, "z": 0.01} in rad and m. With a `radius` (m) the tip may be anywhere in a ball.
    `tip` is the frame to bring there, by default the robot's tip: the name of a link or of an attached object, or a `TipFrame`.

    The last of the way there is straight along `approach`, the way on straight along `retreat`: `zarm.Offset(0.1, (0, 0, 1))` is 0.1 m
    along the tool's z.

    `plan.tip` says which pose was chosen, and `plan.goal_deviation` how far from the goal's it is.
    """

    def __init__(
        self,
        pose: messages.Pose | Numbers,
        *,
        free: Iterable[Axis] = (),
        tolerance: Mapping[str, float] | None = None,
        radius: float | None = None,
        frame: Literal["base", "tool"] = "tool",
        tip: str | messages.TipFrame | None = None,
        approach: messages.Offset | None = None,
        retreat: messages.Offset | None = None,
    ) -> None:
        loose: set[str] = set(free)
        if not isinstance(pose, messages.Pose):
            pose, loose = Pose(pose), loose | set(AXES[:3])
        super().__init__(
            kind="pose",
            position=pose.position,
            orientation=pose.orientation,
            tolerance=tolerance_of(loose, tolerance or {}, radius, frame),
            tip=made(messages.TipFrame, link=tip) if isinstance(tip, str) else tip,
            approach=approach,
            retreat=retreat,
        )


def tolerance_of(
    free: Iterable[str], tolerance: Mapping[str, float], radius: float | None, frame: Literal["base", "tool"]
) -> messages.PoseTolerance | None:
    """The tolerance of a goal, see `PoseGoal`; None if it allows nothing. Raises InvalidRequest that names the argument."""
    bounds: dict[str, float | Literal["free"]] = {**tolerance, **dict.fromkeys(free, "free")}
    if unknown := bounds.keys() - set(AXES):
        field = "tolerance" if unknown & tolerance.keys() else "free"
        raise InvalidRequest(f"{', '.join(sorted(unknown))}: axes are {', '.join(AXES)}", field=field)
    if not bounds and radius is None:
        return None
    values = [bounds.get(axis, 0.0) for axis in AXES]
    return made(
        messages.PoseTolerance, orientation=tuple(values[:3]), position=tuple(values[3:]), radius=radius, frame=frame
    )


class Waypoints(Checked, messages.WaypointsGoal):
    """A motion through poses of the tip and joint positions (rad), in this order and without stopping: `Waypoints(a, b, c)`.

    A waypoint may be `AnyOf` several poses, or a `PoseGoal` with freedom. Each is passed within `position_tolerance` (m) and `angle_tolerance` (rad) of the tip's pose there. The robot rests at
    the last.
    """

    def __init__(
        self,
        *through: messages.Pose | messages.PoseGoal | Numbers,
        position_tolerance: float = 0.005,
        angle_tolerance: float = 0.02,
    ) -> None:
        super().__init__(
            kind="waypoints",
            through=tuple(map(_stop, through)),
            position_tolerance=position_tolerance,
            angle_tolerance=angle_tolerance,
        )


class TipFrame(Checked, messages.TipFrame):
    """A frame of the robot: `offset` (default: none) as seen from `link`, a link of the URDF or an attached object."""

    def __init__(self, link: str, offset: messages.Pose | None = None) -> None:
        super().__init__(link=link, offset=offset or messages.Pose(position=(0.0, 0.0, 0.0)))


class _AlongCurve(TypedDict, total=False):
    speed: float | None
    acceleration: float | None
    rotational_speed: float | None
    orienting: Literal["interpolated", "fixed", "tangent"]
    free: Iterable[Literal["theta_x", "theta_y", "theta_z"]]
    tolerance: Mapping[str, float] | None
    tip: str | messages.TipFrame | None


def _along_curve(**options: Unpack[_AlongCurve]) -> dict[str, object]:
    """The fields that lines, arcs and paths have in common. Raises InvalidRequest that names the argument."""
    free = set(options.get("free", ()))
    fields = {name: value for name, value in options.items() if name not in ("free", "tolerance")}
    allowed = tolerance_of(free, options.get("tolerance") or {}, None, "tool")
    if allowed is not None:
        if any(bound != 0.0 for bound in allowed.position):
            raise InvalidRequest(
                "along a curve only theta_x, theta_y and theta_z may be free", field="free" if free else "tolerance"
            )
        fields["orientation_tolerance"] = allowed.orientation
    tip = options.get("tip")
    if isinstance(tip, str):
        fields["tip"] = made(messages.TipFrame, link=tip)
    return fields


def _oriented(pose: messages.Pose | Numbers) -> dict[str, object]:
    """A pose, or a position alone (m) at which the tip keeps its orientation."""
    if isinstance(pose, messages.Pose):
        return {"position": pose.position, "orientation": pose.orientation}
    return {"position": numbers(pose, "position"), "orientation": None}


class Line(Checked, messages.LineGoal):
    """A straight line of the tip to a `pose`, or to a position (m) with the orientation that it has.

    `speed` (m/s), `acceleration` (m/s^2) and `rotational_speed` (rad/s) bound the motion of the tip, by default as in the descriptor's
    `tool`. The orientation is `interpolated`, `fixed` as at the start, or turns with the `tangent`. Its components that are `free`
    ("theta_z": about the tool's axis) may have any value, others may be off by the `tolerance`, {"theta_x": 0.1} in rad. `tip` is the
    frame that moves so, by default the robot's tip: the name of a link or of an attached object, or a `TipFrame`.
    """

    def __init__(self, pose: messages.Pose | Numbers, **options: Unpack[_AlongCurve]) -> None:
        super().__init__(kind="line", **_oriented(pose), **_along_curve(**options))


class Arc(Checked, messages.ArcGoal):
    """A circular arc of the tip to a `pose` or position (m), through the point `via` or the shorter way around `center` (m). Where it ends
    at its start it is a full circle: give both.

    The other options are those of `Line`.
    """

    def __init__(
        self,
        pose: messages.Pose | Numbers,
        *,
        via: Numbers | None = None,
        center: Numbers | None = None,
        **options: Unpack[_AlongCurve],
    ) -> None:
        super().__init__(
            kind="arc",
            **_oriented(pose),
            via=None if via is None else numbers(via, "via"),
            center=None if center is None else numbers(center, "center"),
            **_along_curve(**options),
        )


class PathPoint(Checked, messages.PathPoint):
    """A point of a `Path`: a `pose` or position (m), reached on an arc through `via` (m) or around `center` (m), left out: on a line. `blend`
    (m) is that of its corner.
    """

    def __init__(
        self,
        pose: messages.Pose | Numbers,
        *,
        via: Numbers | None = None,
        center: Numbers | None = None,
        blend: float | None = None,
    ) -> None:
        super().__init__(
            **_oriented(pose),
            via=None if via is None else numbers(via, "via"),
            center=None if center is None else numbers(center, "center"),
            blend=blend,
        )


class Path(Checked, messages.PathGoal):
    """A path of the tip through poses or positions (m): `Path(a, b, c)`; with a `PathPoint` also on arcs.

    It consists of lines and arcs whose corners are left at most `blend` m before and after each point, by default 0.01; with 0 the
    tip comes to rest there. With `shape` `spline` it is a smooth curve. The other options are those of `Line`.
    """

    def __init__(
        self,
        *points: messages.Pose | messages.PathPoint | Numbers,
        shape: Literal["polyline", "spline"] = "polyline",
        blend: float | None = None,
        **options: Unpack[_AlongCurve],
    ) -> None:
        super().__init__(
            kind="path",
            points=tuple(point if isinstance(point, messages.PathPoint) else PathPoint(point) for point in points),
            shape=shape,
            blend=blend,
            **_along_curve(**options),
        )


class Offset(Checked, messages.Offset):
    """A straight way of `distance` (m) along `direction` in the frame of the tip, `tool`, or the `base`, on which objects may be
    touched: those named in `touch`.
    """

    def __init__(
        self,
        distance: float,
        direction: Numbers,
        frame: Literal["base", "tool"] = "tool",
        *,
        touch: Iterable[str] = (),
    ) -> None:
        super().__init__(distance=distance, direction=numbers(direction, "direction"), frame=frame, touch=tuple(touch))


class Move(Checked, messages.Move):
    """A segment of a program: a motion to any goal that `robot.plan` takes, on which it may touch the objects named in `touch`.
    A `Line` with a `blend` (m) is left so far before its end for the line of the next segment, without stopping. Only the joints of a
    `group` move. `name` says in answers which segment it is.
    """

    def __init__(
        self,
        goal: Goal,
        *,
        blend: float = 0.0,
        touch: Iterable[str] = (),
        group: str | None = None,
        name: str | None = None,
    ) -> None:
        super().__init__(kind="move", goal=goal_of(goal), blend=blend, touch=tuple(touch), group=group, name=name)


class Wait(Checked, messages.Wait):
    """A segment of a program: stand still for `duration` s."""

    def __init__(self, duration: float, *, name: str | None = None) -> None:
        super().__init__(kind="wait", duration=duration, name=name)


class SpeedChange(Checked, messages.SpeedChange):
    """A segment of a program: from here on use these shares of the joints' limits."""

    def __init__(
        self, velocity_scale: float, acceleration_scale: float | None = None, *, name: str | None = None
    ) -> None:
        super().__init__(kind="speed", velocity_scale=velocity_scale, acceleration_scale=acceleration_scale, name=name)


class Attach(Checked, messages.Attach):
    """A segment of a program: attach an object of the scene to the tip, or to a `link`; it may touch `touch_links`, and weighs `mass` (kg) with its
    `center` in its own frame (m; default: its middle).
    """

    def __init__(
        self,
        object: str,  # noqa: A002
        touch_links: Iterable[str] = (),
        *,
        link: str | None = None,
        mass: float | None = None,
        center: tuple[float, float, float] | None = None,
        name: str | None = None,
    ) -> None:
        super().__init__(
            kind="attach",
            object=object,
            touch_links=tuple(touch_links),
            link=link,
            mass=mass,
            center=center,
            name=name,
        )


class Detach(Checked, messages.Detach):
    """A segment of a program: detach an object and leave it where it is."""

    def __init__(self, object: str, *, name: str | None = None) -> None:  # noqa: A002
        super().__init__(kind="detach", object=object, name=name)


class Grip(Checked, messages.Grip):
    """A segment of a program: move a gripper to `width` (m), and go on when its fingers stand there or within `tolerance` (m) of it, as on
    an object of that width. `gripper`, `force` (N) and `speed` (m/s) are as in `robot.gripper.move`.
    """

    def __init__(
        self,
        width: float,
        *,
        gripper: str | None = None,
        force: float | None = None,
        speed: float | None = None,
        tolerance: float = 0.003,
        name: str | None = None,
    ) -> None:
        super().__init__(
            kind="grip", width=width, gripper=gripper, force=force, speed=speed, tolerance=tolerance, name=name
        )


class SetOutput(Checked, messages.SetOutput):
    """A segment of a program: switch `output` `on` or off, and go on when its driver has done so."""

    def __init__(self, output: str, on: bool, *, name: str | None = None) -> None:
        super().__init__(kind="set_output", output=output, on=on, name=name)


OneGoal: TypeAlias = "messages.Pose | messages.PoseGoal | Numbers"
"""Where a motion leads: a pose of the tip, one with freedom, whichever of several is quickest to reach, or joint positions (rad)."""

Goal: TypeAlias = "OneGoal | Waypoints | messages.CartesianGoal | messages.GroupsGoal | Mapping[str, OneGoal]"
"""One of these; waypoints; a line, an arc or a path of the tip; or goals of several groups, by group."""


def goal_of(goal: Goal) -> messages.Goal:
    """A goal as a message for the planner."""
    if isinstance(goal, messages.WaypointsGoal | messages.CartesianGoal | messages.GroupsGoal):
        return goal
    if isinstance(goal, Mapping):
        goals = tuple(made(messages.GroupGoal, group=group, goal=_stop(one)) for group, one in goal.items())
        return made(messages.GroupsGoal, kind="groups", goals=goals)
    return _stop(goal)


def _stop(goal: OneGoal) -> messages.PoseGoal | messages.JointGoal:
    if isinstance(goal, messages.PoseGoal):
        return goal
    try:
        if isinstance(goal, messages.Pose):
            return messages.PoseGoal(kind="pose", position=goal.position, orientation=goal.orientation)
        return messages.JointGoal(kind="joints", position=numbers(goal, "goal"))
    except ValidationError as error:
        raise invalid("goal", error) from None
