"""What the executor sends to a robot's driver, and what the driver tells it; joint states are `JointState`."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated

from pydantic import Field, ValidationInfo, field_validator

from zarm_contract._model import Message, ShortMessage
from zarm_contract.messages.motion import JointNames, Joints, NonNegative, same_length, same_width


class DriverCommand(Message):
    """Points to play from now on, in place of whatever was left to play; no point: stop.

    `time[i]` s from the first point (first 0, strictly increasing), then one row per point, columns in the order of
    `joint_names`, which is the driver's own: rad, rad/s, rad/s^2. `velocity` and `acceleration` are empty where the
    strategy sends positions alone. `sequence` grows with every command of one executor and begins anew with the next.

    A command with points is late, and must be dropped, where it arrives more than `expires_after` s after the driver told the
    joint state with the stamp `based_on`, the newest that the executor had heard; one that says neither always is. A stop is
    never late, and says neither.
    """

    sequence: Annotated[int, Field(ge=1)]
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
    """How far the driver is with the command `sequence`: `fraction` of its points played, 1 at its end."""

    sequence: Annotated[int, Field(ge=1)]
    fraction: Annotated[float, Field(ge=0, le=1)]


class DriverFault(ShortMessage):
    """What a simulated driver suffers from now on, instead of before; what is left out is in order.

    `stall`: it plays no further point, the robot stands and is reported. `drop`: the share of commands that get lost.
    `delay`: s until a command is played. `silent`: it publishes nothing. `die`: its process ends, as by SIGKILL. `jump`:
    the joints are this far (rad) elsewhere, once.
    """

    stall: bool = False
    drop: Annotated[float, Field(ge=0, le=1)] = 0.0
    delay: NonNegative = 0.0
    silent: bool = False
    die: bool = False
    jump: Joints | None = None
