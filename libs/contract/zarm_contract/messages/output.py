"""Digital outputs of a robot, such as a valve or a welding torch, and the messages between the executor and their driver."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from zarm_contract._model import Message, ShortMessage
from zarm_contract.errors import Problem
from zarm_contract.messages.motion import Name, SequenceNumber

MAX_OUTPUT_TIMEOUT = 30.0
"""The longest that a descriptor may let a driver take to switch an output (s)."""


class OutputRequest(ShortMessage):
    """Switch `output` `on` or off. The answer comes when its driver has done so."""

    output: Name
    on: bool


class OutputState(ShortMessage):
    """An output as it was switched last; `on` is left out while nobody has. With a `problem` its driver did not confirm it."""

    output: Name
    on: bool | None = None
    problem: Problem | None = None


class SetOutput(Message):
    """In a program: switch `output` `on` or off at rest, and go on when its driver has done so. If it does not, the goal ends."""

    kind: Literal["set_output"]
    output: Name
    on: bool
    name: Name | None = None


class DriverOutputCommand(ShortMessage):
    """Switch `output` `on` or off. `sequence` increases with every command of one executor; a new executor starts again."""

    output: Name
    sequence: SequenceNumber
    on: bool


class DriverOutputState(ShortMessage):
    """The driver of `output` has carried out the command `sequence`, or, with a `problem`, has not."""

    output: Name
    sequence: SequenceNumber
    problem: Annotated[str, Field(min_length=1, max_length=2000)] | None = None
