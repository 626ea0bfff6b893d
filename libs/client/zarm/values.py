"""Poses, states and trajectories, made from sequences of numbers or numpy arrays.

Each class is the message of that name with convenient arguments. Lengths are m, angles rad, times s; orientations are
unit quaternions (x, y, z, w). An invalid value raises `zarm.InvalidRequest`, which names the field.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypeVar, get_args

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
Axis = Literal["theta_x", "theta_y", "theta_z", "x", "y", "z"]
AXES: tuple[Axis, ...] = get_args(Axis)
"""What a path constraint can hold and a goal leave free, in the order of its flags."""
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


class Checked(Message):
    """A message whose invalid values raise InvalidRequest."""

    model_config = ConfigDict(defer_build=True)

    def __init__(self, **fields: object) -> None:
        try:
            super().__init__(**fields)
        except ValidationError as error:
            raise invalid(type(self).__name__, error) from None


class Pose(Checked, messages.Pose):
    """A frame in the robot's base frame: `Pose((x, y, z), (qx, qy, qz, qw))`, position in m."""

    def __init__(self, position: Numbers, orientation: Numbers = IDENTITY) -> None:
        super().__init__(
            position=numbers(position, "position"),
            orientation=numbers(orientation, "orientation"),
        )


class StartState(Checked, messages.StartState):
    """A start in motion: joint positions (rad), velocities (rad/s) and accelerations (rad/s^2, default: none)."""

    def __init__(self, position: Numbers, velocity: Numbers, acceleration: Numbers | None = None) -> None:
        at = numbers(position, "position")
        super().__init__(
            position=at,
            velocity=numbers(velocity, "velocity"),
            acceleration=(0.0,) * len(at) if acceleration is None else numbers(acceleration, "acceleration"),
        )


class PathConstraint(Checked, messages.PathConstraint):
    """Components of the tip's pose that a motion keeps as they are at its start: `PathConstraint(("theta_x", "theta_y"))`.

    In the `base` frame they are those of the position and of the rotation vector from the start's orientation; in the
    `tool` frame those of the pose as seen from the tip at the start. They may be off by the tolerances (m, rad).

    The tip is that of `group`, by default of the group that moves. With `relative_to` its pose is that in the frame of the
    tip of this other group: two arms that hold one object, `PathConstraint(group="right", relative_to="left")`. If the goal
    moves only the other group, `group` follows.
    """

    def __init__(
        self,
        axes: Iterable[Axis] = AXES,
        *,
        frame: Literal["base", "tool"] = "base",
        position_tolerance: float = 0.005,
        angle_tolerance: float = 0.02,
        group: str | None = None,
        relative_to: str | None = None,
    ) -> None:
        held = set(axes)
        if unknown := held - set(AXES):
            raise InvalidRequest(f"{', '.join(sorted(unknown))}: axes are {', '.join(AXES)}", field="axes")
        super().__init__(
            axes=tuple(axis in held for axis in AXES),
            frame=frame,
            position_tolerance=position_tolerance,
            angle_tolerance=angle_tolerance,
            group=group,
            relative_to=relative_to,
        )


class Trajectory(Checked, messages.Trajectory):
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


def pose_of(pose: messages.Pose) -> Pose:
    """A pose from a message."""
    return Pose(pose.position, pose.orientation)
