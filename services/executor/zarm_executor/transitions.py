"""The transitions between the modes of the robot: the one table that the documentation is generated from, and that a
test compares with the modes seen under random commands.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from zarm_contract.messages import RobotMode

MODES: Mapping[RobotMode, str] = {
    "idle": "The robot rests; nothing is active.",
    "running": "A goal moves the robot, or is held by the servo's authority.",
    "stopping": "The robot brakes along its path.",
    "paused": "The robot rests and keeps its goal.",
    "fault": "Something went wrong in motion; `problem` says what.",
}
"""What each mode means."""


class Transition(NamedTuple):
    """One arrow; `causes` are what leads along it."""

    before: RobotMode
    after: RobotMode
    causes: tuple[str, ...]


_ENDS = ("cancel", "stop", "preemption", "switch of strategy", "SIGTERM")

TRANSITIONS = (
    Transition("idle", "running", ("execute", "first chunk of a stream")),
    Transition("running", "idle", ("at the goal", "at rest beside it")),
    Transition(
        "running",
        "stopping",
        ("pause", *_ENDS, "violation", "felt collision", "late or impossible chunk", "held too long"),
    ),
    Transition("running", "fault", ("violation while the robot rests",)),
    Transition("stopping", "running", ("resume, while braking for a pause",)),
    Transition("stopping", "paused", ("at rest after a pause",)),
    Transition("stopping", "idle", ("at rest, without a violation",)),
    Transition("stopping", "fault", ("at rest after a violation", "not at rest in time")),
    Transition("paused", "running", ("resume",)),
    Transition("paused", "stopping", (*_ENDS, "violation")),
    Transition("paused", "fault", ("violation while the robot rests",)),
    Transition("idle", "fault", ("no strategy can be opened",)),
    Transition("fault", "idle", ("reset",)),
    Transition("fault", "running", ("execute, where faults clear at rest",)),
)
