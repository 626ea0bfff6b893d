"""Poses, joint states and trajectories, and the value types that all messages use."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Annotated

from pydantic import AfterValidator, Field, ValidationInfo, field_validator

from zarm_contract._model import Message, ShortMessage

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]{1,64}$")]
"""Letters, digits, `_`, `.` and `-`: a name that is also one chunk of a key expression."""
Joints = Annotated[tuple[float, ...], Field(min_length=1, max_length=32)]
"""One value per joint of the descriptor, in its order."""
Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
SequenceNumber = Annotated[int, Field(ge=1, lt=2**53)]
"""A number that JSON readers of every language hold exactly."""
Scale = Annotated[float, Field(gt=0, le=1)]
Vector3 = tuple[float, float, float]


def _unit(q: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    norm = math.sqrt(sum(x * x for x in q))
    if abs(norm - 1.0) > 1e-3:
        raise ValueError(f"the quaternion (x, y, z, w) has length {norm:.6g}; normalise it to 1")
    if abs(norm - 1.0) < 1e-12:  # normalised already: dividing again would change the last digit with every hop
        return q
    return (q[0] / norm, q[1] / norm, q[2] / norm, q[3] / norm)


Quaternion = Annotated[tuple[float, float, float, float], AfterValidator(_unit)]
"""`(x, y, z, w)`; a length within 1e-3 of one is normalised, any other is refused."""


def _distinct(names: tuple[str, ...]) -> tuple[str, ...]:
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"the joint {name} appears twice; name each joint once")
    return names


JointNames = Annotated[tuple[str, ...], Field(min_length=1, max_length=32), AfterValidator(_distinct)]
"""Which joint each column is; no name twice."""


def same_width(rows: Sequence[Sequence[float]], info: ValidationInfo) -> None:
    """For a validator: raise ValueError where a row has another number of entries than `joint_names`."""
    width: Sequence[str] | None = info.data.get("joint_names")
    if width is not None and set(map(len, rows)) - {len(width)}:  # thousands of rows: no call for each
        for row in rows:
            same_length(row, info, "joint_names")


def same_length(values: Sequence[object], info: ValidationInfo, other: str) -> None:
    """For a validator: raise ValueError where `values` has another length than the field `other`."""
    expected: Sequence[object] | None = info.data.get(other)  # absent when `other` itself is at fault
    if expected is not None and len(values) != len(expected):
        raise ValueError(f"{len(values)} entries where {other} has {len(expected)}")


class Pose(Message):
    """A frame: `position` (m) and `orientation`, a unit quaternion `[x, y, z, w]`."""

    position: Vector3
    orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)


class JointState(ShortMessage):
    """Measured or previewed joints at the time `stamp` (Unix, s): `position` (rad) and `velocity` (rad/s).

    `effort` (Nm; N if prismatic) is what the drives exert, left out where it is not measured.
    """

    stamp: float
    joint_names: JointNames
    position: Joints
    velocity: Joints
    effort: Joints | None = None

    @field_validator("position", "velocity", "effort")
    @classmethod
    def _one_per_joint(cls, values: tuple[float, ...] | None, info: ValidationInfo) -> tuple[float, ...] | None:
        if values is not None:
            same_length(values, info, "joint_names")
        return values


class Trajectory(Message):
    """Joint positions with time: sample `i` is at `time[i]` s; the first time is 0 and times increase strictly.

    Every sample has `position` (rad), `velocity` (rad/s) and `acceleration` (rad/s²). Between two samples the motion is the
    quintic polynomial that meets all three at both ends, as in the JointTrajectoryController of ros2_control.
    """

    joint_names: JointNames
    time: tuple[NonNegative, ...] = Field(min_length=2)
    position: tuple[Joints, ...]
    velocity: tuple[Joints, ...]
    acceleration: tuple[Joints, ...]

    @property
    def duration(self) -> float:
        """Seconds from the first to the last sample."""
        return self.time[-1]

    @field_validator("time")
    @classmethod
    def _from_zero_onwards(cls, time: tuple[float, ...]) -> tuple[float, ...]:
        if time[0] != 0.0:
            raise ValueError("time must start at 0")
        if any(b <= a for a, b in pairwise(time)):
            raise ValueError("time must increase strictly from sample to sample")
        return time

    @field_validator("position", "velocity", "acceleration")
    @classmethod
    def _one_row_per_sample(
        cls, rows: tuple[tuple[float, ...], ...], info: ValidationInfo
    ) -> tuple[tuple[float, ...], ...]:
        same_length(rows, info, "time")
        same_width(rows, info)
        return rows


class Touch(Message):
    """Objects of the scene that the robot, or what it carries, may touch from `begin` to `end` (s) of a trajectory."""

    objects: tuple[Name, ...] = Field(min_length=1, max_length=32)
    begin: NonNegative
    end: NonNegative
