"""Programs: motions, waits and changes of what the robot carries, planned as a whole."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from zarm_contract._model import Message
from zarm_contract.messages.goals import Blend, Goal, GroupName
from zarm_contract.messages.gripper import Grip, Openings
from zarm_contract.messages.motion import Joints, Name, Positive, Scale, Vector3
from zarm_contract.messages.output import SetOutput
from zarm_contract.messages.planner import Attempts, Margin, Timeout


class Move(Message):
    """Move to a goal, or along a line, an arc or a path. `name` says in answers which segment it is.

    The robot, or what it carries, may touch the objects named in `touch` on the way. A line or an arc with a `blend` (m) is left so far
    before its end, without stopping, for the line or arc of the next segment, which has the same options. A motion to joints or a pose with a
    `blend` passes its goal within that distance (0.5 mm to 0.1 m) and 0.5 rad, without stopping, on the way to those of the next segment. `group` as in `PlanRequest`.
    """

    kind: Literal["move"]
    goal: Goal
    group: GroupName | None = None
    blend: Blend = 0.0
    touch: tuple[Name, ...] = Field(default=(), max_length=32)
    name: Name | None = None


class Wait(Message):
    """Stand still for `duration` (s)."""

    kind: Literal["wait"]
    duration: Annotated[float, Field(gt=0, le=3600)]
    name: Name | None = None


class SpeedChange(Message):
    """Use these shares of the joints' limits from here on, in place of those of the request."""

    kind: Literal["speed"]
    velocity_scale: Scale
    acceleration_scale: Scale | None = None
    name: Name | None = None


class Attach(Message):
    """Attach `object` of the scene to the tip, or to a `link`, where it then is, as `AttachObject` does; the planner edits the scene when
    the robot gets there.
    """

    kind: Literal["attach"]
    object: Name
    touch_links: tuple[str, ...] = Field(default=(), max_length=32)
    link: str | None = None
    mass: Positive | None = None
    center: Vector3 | None = None
    name: Name | None = None


class Detach(Message):
    """Detach `object` and leave it where it then is; the planner edits the scene when the robot gets there."""

    kind: Literal["detach"]
    object: Name
    name: Name | None = None


Segment = Annotated[Move | Wait | SpeedChange | Attach | Detach | Grip | SetOutput, Field(discriminator="kind")]


class ProgramRequest(Message):
    """Plan `segments` one after the other, as one motion that rests between them, from `start` (rad; default: the measured joints).

    The configuration in which a segment ends is chosen so that the lines, arcs and paths after it can be followed. The other fields
    are those of `PlanRequest`, for every segment; `timeout` (s) is the deadline of the whole program. With `partial` a program of which a
    segment fails is answered with the plan of the segments before it, if they move the robot; its `problem` names the one that fails.
    """

    segments: tuple[Segment, ...] = Field(min_length=1, max_length=200)
    start: Joints | None = None
    request_id: Name | None = None
    timeout: Timeout | None = None
    max_attempts: Attempts | None = None
    velocity_scale: Scale | None = None
    acceleration_scale: Scale | None = None
    margin: Margin | None = None
    self_margin: Margin | None = None
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0
    publish: bool = True
    partial: bool = False
    openings: Openings = ()
