"""Commands to grippers, their state, and the messages between the executor and a gripper's driver."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, ValidationInfo, field_validator

from zarm_contract._model import Message, ShortMessage
from zarm_contract.errors import Problem
from zarm_contract.messages.motion import Name, NonNegative, Positive, SequenceNumber

GripperStatus = Literal["idle", "moving", "reached", "stalled", "cancelled", "aborted"]


class GripperOpening(ShortMessage):
    """How far `gripper` is open: `width` m between its pads."""

    gripper: Name
    width: NonNegative


Openings = Annotated[tuple[GripperOpening, ...], Field(max_length=8)]


class GripperRequest(ShortMessage):
    """Move a gripper until its opening is `width` (m), or its joint at `position` (rad, m for a prismatic joint); give one of them.

    `gripper` may be left out where the robot has only one. `force` (N) and `speed` (m/s of the opening) are by default the
    descriptor's, which are also the greatest. The gripper then holds with this force. While it moves for another goal the answer is
    `busy`, unless `preempt` ends that one. `goal_id` names the goal (default: chosen by the executor).
    """

    gripper: Name | None = None
    width: NonNegative | None = None
    position: float | None = None
    force: Positive | None = None
    speed: Positive | None = None
    preempt: bool = False
    goal_id: Name | None = None

    @field_validator("position")
    @classmethod
    def _one_target(cls, position: float | None, info: ValidationInfo) -> float | None:
        if position is not None and info.data.get("width") is not None:
            raise ValueError("width is given too; give one of them")
        return position


class Grip(Message):
    """In a program: move a gripper to `width` (m), and go on when its fingers stand there, or within `tolerance` (m) of it, as on an object of
    that width.

    What follows is verified with this opening. Fingers that stand elsewhere, or do not move, end the goal. `gripper`, `force` and `speed` are
    as in `GripperRequest`.
    """

    kind: Literal["grip"]
    width: NonNegative
    gripper: Name | None = None
    force: Positive | None = None
    speed: Positive | None = None
    tolerance: Annotated[float, Field(gt=0, le=0.005)] = 0.003
    name: Name | None = None


class PlannedGrip(Message):
    """What a `Grip` has the executor do: see there."""

    gripper: Name
    width: NonNegative
    force: Positive | None = None
    speed: Positive | None = None
    tolerance: Positive


class GripperCancel(ShortMessage):
    """Stop a gripper where it is, and hold; `gripper` may be left out where the robot has only one."""

    gripper: Name | None = None


class GripperState(ShortMessage):
    """A gripper: its opening `width` (m) and the `position` of its joint (rad, m) as measured, left out while no driver reports them.

    `status` is that of the goal `goal_id`, which moves it to the opening `target` (m). `reached`: it is there. `stalled`: the fingers stand
    before it, usually because they hold something. `idle`: it has had no goal yet. A goal that is `aborted` has a `problem`. `widths` (m)
    are its openings when closed and open. `touch_links` are the links that may touch what it holds: its fingers and its palm.
    """

    gripper: Name
    status: GripperStatus
    widths: tuple[NonNegative, NonNegative]
    touch_links: tuple[str, ...] = ()
    width: NonNegative | None = None
    position: float | None = None
    goal_id: Name | None = None
    target: NonNegative | None = None
    problem: Problem | None = None

    @property
    def done(self) -> bool:
        """Whether no goal moves it."""
        return self.status != "moving"


class DriverGripperCommand(ShortMessage):
    """Move the joint of `gripper` to `position` (rad, m), at `speed` (rad/s, m/s) and with at most `force` (N), and hold it there.

    `sequence` increases with every command of one executor; a new executor starts again.
    """

    gripper: Name
    sequence: SequenceNumber
    position: float
    speed: Positive
    force: Positive


class DriverGripperState(ShortMessage):
    """Where a driver has measured the joint of `gripper` (rad, m), or what became of the command `sequence`; each may be left out.

    `reached`: the joint is there. `stalled`: it stands before that. With a `problem` the driver does no more for the command.
    """

    gripper: Name
    position: float | None = None
    sequence: SequenceNumber | None = None
    reached: bool = False
    stalled: bool = False
    problem: Annotated[str, Field(min_length=1, max_length=2000)] | None = None
