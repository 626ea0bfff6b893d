"""Messages between the executor and a robot's driver; joint states are `JointState`."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated

from pydantic import Field, ValidationInfo, field_validator

from zarm_contract._model import Message, ShortMessage
from zarm_contract.messages.motion import (
    JointNames,
    Joints,
    Name,
    NonNegative,
    SequenceNumber,
    Vector3,
    same_length,
    same_width,
)


class DriverCommand(Message):
    """The points to play from now on, instead of what is left of the last command. No points: stop.

    Point `i` is at `time[i]` (s; the first is 0, strictly increasing). The columns are in the order of `joint_names`, which is
    that of the driver: rad, rad/s, rad/s². A strategy that sends only positions leaves `velocity` and `acceleration` empty.
    `sequence` increases with every command of one executor; a new executor starts again.

    Drop a command with points that arrives more than `expires_after` (s) after the driver reported the joint state with the
    stamp `based_on`, or that has neither field. A stop has neither and never expires.
    """

    sequence: SequenceNumber
    joint_names: JointNames
    based_on: float | None = None
    expires_after: Annotated[float, Field(gt=0)] | None = None
    time: tuple[NonNegative, ...] = ()
    position: tuple[Joints, ...] = ()
    velocity: tuple[Joints, ...] = ()
    acceleration: tuple[Joints, ...] = ()

    @field_validator("time")
    @classmethod
    def _from_zero_onwards(cls, time: tuple[float, ...]) -> tuple[float, ...]:
        if time and time[0] != 0.0:
            raise ValueError("time must start at 0")
        if any(b <= a for a, b in pairwise(time)):
            raise ValueError("time must increase strictly from point to point")
        return time

    @field_validator("position", "velocity", "acceleration")
    @classmethod
    def _one_row_per_point(
        cls, rows: tuple[tuple[float, ...], ...], info: ValidationInfo
    ) -> tuple[tuple[float, ...], ...]:
        if rows or info.field_name == "position":
            same_length(rows, info, "time")
        same_width(rows, info)
        return rows


class DriverProgress(ShortMessage):
    """The share of the points of command `sequence` that the driver has played; 1 at the end.

    With a `problem` it plays no further, for the reason that this gives: it refused the command, or has ended it.
    """

    sequence: SequenceNumber
    fraction: Annotated[float, Field(ge=0, le=1)]
    problem: Annotated[str, Field(min_length=1, max_length=2000)] | None = None


class DriverSpeed(ShortMessage):
    """The share of the commanded speed at which the robot moves by its own controls: a speed slider, or 0 while it is paused."""

    scale: Annotated[float, Field(ge=0, le=1)]


class DriverFault(ShortMessage):
    """The faults of a simulated driver from now on; a field that is left out has no fault.

    `stall`: play no further point; the robot stands and is still reported. `drop`: share of commands that are lost. `delay`
    (s): from a command to its first point. `silent`: publish nothing. `die`: end the process, as by SIGKILL. `jump` (rad): move
    the reported joints by this much, once. `obstacle` (m): an object of this width stops the fingers of its grippers.
    `output`: this output cannot be switched. `push` (N): a force on the tip, along the axes of the base; it needs a driver with physics.
    """

    stall: bool = False
    drop: Annotated[float, Field(ge=0, le=1)] = 0.0
    delay: NonNegative = 0.0
    silent: bool = False
    die: bool = False
    jump: Joints | None = None
    obstacle: NonNegative | None = None
    output: Name | None = None
    push: Vector3 | None = None
