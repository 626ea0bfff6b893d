"""Poses, goals, objects of the scene and trajectories, made from sequences of numbers or numpy arrays.

Each class is the message of that name with convenient arguments. Lengths are m, angles rad, times s; orientations are
unit quaternions (x, y, z, w). An invalid value raises `zarm.InvalidRequest`, which names the field.
"""

from __future__ import annotations

import sys
from array import array
from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypedDict, TypeVar, Unpack

from pydantic import ConfigDict, ValidationError

from zarm_contract import messages
from zarm_contract._faults import field_path, sentence
from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import Message

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    Numbers: TypeAlias = Sequence[float] | npt.NDArray[np.floating[Any]]
    """Numbers in a row: a tuple, a list, or a numpy array of one dimension."""
    Rows: TypeAlias = Sequence[Numbers] | npt.NDArray[np.floating[Any]]
    """Rows of numbers: sequences in a sequence, or a numpy array (rows, columns)."""

IDENTITY = (0.0, 0.0, 0.0, 1.0)
"""The orientation (x, y, z, w) of an unrotated frame."""
AXES = messages.POSE_COMPONENTS
"""What a path constraint can hold and a goal leave free, in the order of its flags."""

Axis = Literal["theta_x", "theta_y", "theta_z", "x", "y", "z"]
M = TypeVar("M", bound=Message)


def numbers(values: Numbers, field: str) -> tuple[float, ...]:
    """Numbers in message form. Raises InvalidRequest for anything else."""
    try:
        return tuple(map(float, values))
    except (TypeError, ValueError) as error:
        raise InvalidRequest(f"a list of numbers is needed, not {values!r:.200}", field=field) from error


def joints_of(values: Numbers | None, field: str) -> tuple[float, ...] | None:
    """Joint positions in message form; None, for the measured ones, stays None."""
    return None if values is None else numbers(values, field)


def rows(values: Rows, field: str) -> tuple[tuple[float, ...], ...]:
    """Rows of numbers in message form. Raises InvalidRequest for anything else."""
    whole = getattr(values, "tolist", None)  # for numpy arrays many times faster than row by row
    try:
        return tuple(numbers(row, field) for row in (values if whole is None else whole()))
    except TypeError as error:
        raise InvalidRequest(f"a list of rows of numbers is needed, not {values!r:.200}", field=field) from error


def invalid(kind: str, error: ValidationError, data: object = None) -> InvalidRequest:
    """The error for a message that cannot be made of `data`, which names the field at fault."""
    first = error.errors(include_url=False, include_input=False)[0]
    path = field_path(first["loc"], data)
    return InvalidRequest(f"{kind}: {sentence(first['msg'])}", field=".".join(map(str, path)) or None)


def made(model: type[M], **fields: object) -> M:
    """A message of these fields. Raises InvalidRequest that names the field at fault."""
    try:
        return model(**fields)
    except ValidationError as error:
        raise invalid(model.__name__, error) from None


class _Checked(Message):
    model_config = ConfigDict(defer_build=True)

    def __init__(self, **fields: object) -> None:
        try:
            super().__init__(**fields)
        except ValidationError as error:
            raise invalid(type(self).__name__, error) from None


class Pose(_Checked, messages.Pose):
    """A frame in the robot's base frame: `Pose((x, y, z), (qx, qy, qz, qw))`, position in m."""

    def __init__(self, position: Numbers, orientation: Numbers = IDENTITY) -> None:
        super().__init__(
            position=numbers(position, "position"),
            orientation=numbers(orientation, "orientation"),
        )


class AnyOf(_Checked, messages.PoseGoal):
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


class PoseGoal(_Checked, messages.PoseGoal):
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


class Waypoints(_Checked, messages.WaypointsGoal):
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


class TipFrame(_Checked, messages.TipFrame):
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


class Line(_Checked, messages.LineGoal):
    """A straight line of the tip to a `pose`, or to a position (m) with the orientation that it has.

    `speed` (m/s), `acceleration` (m/s^2) and `rotational_speed` (rad/s) bound the motion of the tip, by default as in the descriptor's
    `tool`. The orientation is `interpolated`, `fixed` as at the start, or turns with the `tangent`. Its components that are `free`
    ("theta_z": about the tool's axis) may have any value, others may be off by the `tolerance`, {"theta_x": 0.1} in rad. `tip` is the
    frame that moves so, by default the robot's tip: the name of a link or of an attached object, or a `TipFrame`.
    """

    def __init__(self, pose: messages.Pose | Numbers, **options: Unpack[_AlongCurve]) -> None:
        super().__init__(kind="line", **_oriented(pose), **_along_curve(**options))


class Arc(_Checked, messages.ArcGoal):
    """A circular arc of the tip to a `pose` or position (m), through the point `via` or the shorter way around `center` (m).

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


class Path(_Checked, messages.PathGoal):
    """A path of the tip through poses or positions (m): `Path(a, b, c)`.

    It consists of straight lines whose corners are left at most `blend` m before and after each point, by default 0.01; with 0 the
    tip comes to rest there. With `shape` `spline` it is a smooth curve. The other options are those of `Line`.
    """

    def __init__(
        self,
        *points: messages.Pose | Numbers,
        shape: Literal["polyline", "spline"] = "polyline",
        blend: float | None = None,
        **options: Unpack[_AlongCurve],
    ) -> None:
        super().__init__(
            kind="path",
            points=tuple(made(messages.PathPoint, **_oriented(point)) for point in points),
            shape=shape,
            blend=blend,
            **_along_curve(**options),
        )


class Offset(_Checked, messages.Offset):
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


class Move(_Checked, messages.Move):
    """A segment of a program: a motion to any goal that `robot.plan` takes, on which it may touch the objects named in `touch`.
    A `Line` with a `blend` (m) is left so far before its end for the line of the next segment, without stopping. `name` says in
    answers which segment it is.
    """

    def __init__(self, goal: Goal, *, blend: float = 0.0, touch: Iterable[str] = (), name: str | None = None) -> None:
        super().__init__(kind="move", goal=goal_of(goal), blend=blend, touch=tuple(touch), name=name)


class Wait(_Checked, messages.Wait):
    """A segment of a program: stand still for `duration` s."""

    def __init__(self, duration: float, *, name: str | None = None) -> None:
        super().__init__(kind="wait", duration=duration, name=name)


class SpeedChange(_Checked, messages.SpeedChange):
    """A segment of a program: from here on use these shares of the joints' limits."""

    def __init__(
        self, velocity_scale: float, acceleration_scale: float | None = None, *, name: str | None = None
    ) -> None:
        super().__init__(kind="speed", velocity_scale=velocity_scale, acceleration_scale=acceleration_scale, name=name)


class Attach(_Checked, messages.Attach):
    """A segment of a program: attach an object of the scene to the tip; it may touch `touch_links`."""

    def __init__(self, object: str, touch_links: Iterable[str] = (), *, name: str | None = None) -> None:  # noqa: A002
        super().__init__(kind="attach", object=object, touch_links=tuple(touch_links), name=name)


class Detach(_Checked, messages.Detach):
    """A segment of a program: detach an object and leave it where it is."""

    def __init__(self, object: str, *, name: str | None = None) -> None:  # noqa: A002
        super().__init__(kind="detach", object=object, name=name)


class StartState(_Checked, messages.StartState):
    """A start in motion: joint positions (rad), velocities (rad/s) and accelerations (rad/s^2, default: none)."""

    def __init__(self, position: Numbers, velocity: Numbers, acceleration: Numbers | None = None) -> None:
        at = numbers(position, "position")
        super().__init__(
            position=at,
            velocity=numbers(velocity, "velocity"),
            acceleration=(0.0,) * len(at) if acceleration is None else numbers(acceleration, "acceleration"),
        )


class PathConstraint(_Checked, messages.PathConstraint):
    """Components of the tip's pose that a motion keeps as they are at its start: `PathConstraint(("theta_x", "theta_y"))`.

    In the `base` frame they are those of the position and of the rotation vector from the start's orientation; in the
    `tool` frame those of the pose as seen from the tip at the start. They may be off by the tolerances (m, rad).
    """

    def __init__(
        self,
        axes: Iterable[Axis],
        *,
        frame: Literal["base", "tool"] = "base",
        position_tolerance: float = 0.005,
        angle_tolerance: float = 0.02,
    ) -> None:
        held = set(axes)
        if unknown := held - set(AXES):
            raise InvalidRequest(f"{', '.join(sorted(unknown))}: axes are {', '.join(AXES)}", field="axes")
        super().__init__(
            axes=tuple(axis in held for axis in AXES),
            frame=frame,
            position_tolerance=position_tolerance,
            angle_tolerance=angle_tolerance,
        )


class Cuboid(_Checked, messages.Cuboid):
    """A box; `size` are the full edge lengths (m) along its own x, y, z, `position` is its centre."""

    def __init__(self, name: str, *, size: Numbers, position: Numbers, orientation: Numbers = IDENTITY) -> None:
        super().__init__(**_placed("cuboid", name, position, orientation), size=numbers(size, "size"))


class Sphere(_Checked, messages.Sphere):
    """A ball of `radius` (m) around `position`."""

    def __init__(self, name: str, *, radius: float, position: Numbers) -> None:
        super().__init__(kind="sphere", name=name, position=numbers(position, "position"), radius=radius)


class Capsule(_Checked, messages.Capsule):
    """All points within `radius` (m) of a segment of `length` (m) along its own z, centred at `position`."""

    def __init__(
        self, name: str, *, radius: float, length: float, position: Numbers, orientation: Numbers = IDENTITY
    ) -> None:
        super().__init__(**_placed("capsule", name, position, orientation), radius=radius, length=length)


class Cylinder(_Checked, messages.Cylinder):
    """A cylinder with flat ends, `length` (m) along its own z, centred at `position`."""

    def __init__(
        self, name: str, *, radius: float, length: float, position: Numbers, orientation: Numbers = IDENTITY
    ) -> None:
        super().__init__(**_placed("cylinder", name, position, orientation), radius=radius, length=length)


class Mesh(_Checked, messages.Mesh):
    """Triangles of an STL or OBJ `file`, a path inside one of the planner's mesh folders; a closed mesh is solid.

    `scale` multiplies the file's coordinates to make them m: one number, or one for each axis; 0.001 for mm. With `data`, the content of the
    file, the planner needs no file of this name.
    """

    def __init__(
        self,
        name: str,
        *,
        file: str | FilePath,
        position: Numbers,
        orientation: Numbers = IDENTITY,
        scale: float | Numbers = 1.0,
        data: bytes | str | None = None,
        sha256: str | None = None,
    ) -> None:
        factors = (float(scale),) * 3 if isinstance(scale, int | float) else numbers(scale, "scale")
        super().__init__(
            **_placed("mesh", name, position, orientation),
            file=str(file),
            scale=factors,
            data=b64encode(data).decode() if isinstance(data, bytes) else data,
            sha256=sha256,
        )


class Voxels(_Checked, messages.Voxels):
    """Occupied cubes with edges of `resolution` m: cell (i, j, k) has its centre at (i, j, k) * `resolution`.

    `cells` are whole numbers (n, 3); `position` and `orientation` place the grid.
    """

    def __init__(
        self,
        name: str,
        *,
        resolution: float,
        cells: Sequence[Sequence[int]] | npt.NDArray[np.integer[Any]],
        position: Numbers = (0.0, 0.0, 0.0),
        orientation: Numbers = IDENTITY,
    ) -> None:
        whole = tuple(tuple(map(int, cell)) for cell in cells)
        super().__init__(**_placed("voxels", name, position, orientation), resolution=resolution, cells=whole)


_LISTED = 10_000
"""Most points of a cloud that are sent as a list, which people can read."""


def _packed(points: Sequence[Sequence[float]]) -> str:
    """Points as `messages.PointCloud` packs them. Raises InvalidRequest for rows of other lengths than 3."""
    if any(len(point) != 3 for point in points):
        raise InvalidRequest("each point has three coordinates", field="points")
    found = array("d", chain.from_iterable(points))
    if sys.byteorder == "big":
        found.byteswap()
    return b64encode(found).decode()


class PointCloud(_Checked, messages.PointCloud):
    """Points (n, 3) in m that are obstacles; the scene keeps the voxels of `resolution` m that they lie in.

    `position` and `orientation` are those of the frame of the points.
    """

    def __init__(
        self,
        name: str,
        points: Rows,
        *,
        resolution: float = 0.02,
        position: Numbers = (0.0, 0.0, 0.0),
        orientation: Numbers = IDENTITY,
    ) -> None:
        listed = rows(points, "points")
        content = listed if len(listed) <= _LISTED else _packed(listed)
        super().__init__(**_placed("cloud", name, position, orientation), resolution=resolution, points=content)


class Trajectory(_Checked, messages.Trajectory):
    """A timed motion of the joints: a row for each of the n moments `time` (s, from 0), a column for each joint.

    `position` (rad), `velocity` (rad/s) and `acceleration` (rad/s^2) are (n, joints). Between the rows the motion is the
    quintic polynomial that meets all three at both ends.
    """

    def __init__(
        self, joint_names: Iterable[str], time: Numbers, position: Rows, velocity: Rows, acceleration: Rows
    ) -> None:
        super().__init__(
            joint_names=tuple(joint_names),
            time=numbers(time, "time"),
            position=rows(position, "position"),
            velocity=rows(velocity, "velocity"),
            acceleration=rows(acceleration, "acceleration"),
        )


Goal: TypeAlias = "messages.Pose | messages.PoseGoal | Waypoints | messages.CartesianGoal | Numbers"
"""Where a motion leads: a pose of the tip, one with freedom, whichever of several is quickest to reach, joint positions (rad),
waypoints; or a line, an arc or a path of the tip."""


def goal_of(goal: Goal) -> messages.Goal:
    """A goal as a message for the planner."""
    if isinstance(goal, messages.WaypointsGoal | messages.CartesianGoal):
        return goal
    return _stop(goal)


def pose_of(pose: messages.Pose) -> Pose:
    """A pose from a message."""
    return Pose(pose.position, pose.orientation)


def object_of(item: messages.SceneObject) -> messages.SceneObject:
    """An object from a message, as the matching class of this module."""
    made: messages.SceneObject = _CLASSES[item.kind].model_construct(
        **{name: getattr(item, name) for name in type(item).model_fields}
    )
    return made


def _stop(goal: messages.Pose | messages.PoseGoal | Numbers) -> messages.PoseGoal | messages.JointGoal:
    if isinstance(goal, messages.PoseGoal):
        return goal
    try:
        if isinstance(goal, messages.Pose):
            return messages.PoseGoal(kind="pose", position=goal.position, orientation=goal.orientation)
        return messages.JointGoal(kind="joints", position=numbers(goal, "goal"))
    except ValidationError as error:
        raise invalid("goal", error) from None


def _placed(kind: str, name: str, position: Numbers, orientation: Numbers) -> dict[str, object]:
    return {
        "kind": kind,
        "name": name,
        "position": numbers(position, "position"),
        "orientation": numbers(orientation, "orientation"),
    }


_CLASSES: dict[str, type[Any]] = {
    "cuboid": Cuboid,
    "sphere": Sphere,
    "capsule": Capsule,
    "cylinder": Cylinder,
    "mesh": Mesh,
    "voxels": Voxels,
}
