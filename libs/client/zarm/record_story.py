"""The story of a record: its events, and how far the robot was from its command."""

from __future__ import annotations

import itertools
from bisect import bisect
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field

from zarm_contract.codec import decode
from zarm_contract.errors import InvalidRequest, Problem
from zarm_contract.keys import Keys
from zarm_contract.messages import (
    DriverCommand,
    ExecutorState,
    GoalState,
    JointState,
    Message,
    Plan,
    SceneEdited,
    Speed,
    Strategies,
    StreamChunk,
)
from zarm_runtime.recorded import Recorded


@dataclass(frozen=True)
class Event:
    """A change, `time` s after the record begins."""

    time: float
    subject: str
    what: str


@dataclass(frozen=True)
class Deviation:
    """How far (rad) a joint was from its command, `time` s after the record begins."""

    time: float
    joint: str
    commanded: float
    measured: float

    @property
    def size(self) -> float:
        """Its amount, rad."""
        return abs(self.measured - self.commanded)


@dataclass
class Story:
    """`began` in ns, `lasted` in s, `counts` of messages by key, without the `unreadable` ones."""

    robot: str
    began: int
    lasted: float = 0.0
    events: list[Event] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)
    unreadable: int = 0
    deviation: Deviation | None = None


def robot_of(key: str) -> str:
    """The robot of a recorded key. Raises InvalidRequest if it is not a key of zarm."""
    chunks = key.split("/")
    if chunks[0] != "zarm" or len(chunks) < 3:
        raise InvalidRequest(
            f"the file holds {key!r}, which is not a key of zarm; it is no record of a robot", field="file"
        )
    return chunks[1]


def summarize(entries: Iterable[tuple[int, str, bytes]]) -> Story:
    """The story of a record's messages, in order of time. Raises InvalidRequest if none is of zarm."""
    entries = iter(entries)
    if (first := next(entries, None)) is None:
        raise InvalidRequest(
            "the record is empty: nothing was on the bus; see `zarm status` while recording", field="file"
        )
    story = Story(robot_of(first[1]), first[0])
    keys, teller = Keys(story.robot), _Teller()
    recorded = Recorded(keys, scene=True)
    for stamp, key, payload in itertools.chain((first,), entries):
        story.lasted = (stamp - story.began) / 1e9
        model = recorded.model(key)
        if model is None:
            continue
        try:
            message = decode(model, payload)
        except InvalidRequest:  # an invalid message on the bus, recorded as it was
            story.unreadable += 1
            continue
        story.counts[key] += 1
        if isinstance(message, JointState):
            if key == keys.joint_states:
                teller.measure(story.lasted, message)
        elif line := teller.change(key, message, story.lasted):
            story.events.append(Event(story.lasted, *line))
    story.deviation = teller.deviation()
    return story


class _Teller:
    """Remembers the last message on each key, and where the robot was commanded and measured."""

    def __init__(self) -> None:
        self._said: dict[str, tuple[str, str]] = {}
        self._commanded: list[tuple[float, tuple[float, ...]]] = []
        self._measured: list[JointState] = []
        self._measured_at: list[float] = []

    def measure(self, time: float, state: JointState) -> None:
        self._measured_at.append(time)
        self._measured.append(state)

    def change(self, key: str, message: Message, time: float) -> tuple[str, str] | None:
        """The news in a message compared with the last one on its key: the subject and the change."""
        if isinstance(message, GoalState):
            self._commanded.append((time, message.joint_command))
        line = _line(message)
        if line is None or self._said.get(key) == line:
            return None
        self._said[key] = line
        return line

    def deviation(self) -> Deviation | None:
        """The largest one, between the command in a goal's state and the joints measured at that moment.

        Measured joints are interpolated linearly. None if the two do not overlap in the record.
        """
        greatest: Deviation | None = None
        for time, command in self._commanded:
            after = bisect(self._measured_at, time)
            if not 0 < after < len(self._measured_at):
                continue
            (t0, a), (t1, b) = ((self._measured_at[i], self._measured[i]) for i in (after - 1, after))
            if len(a.position) != len(command) or a.joint_names != b.joint_names:
                continue
            share = (time - t0) / (t1 - t0)
            for joint, q, q0, q1 in zip(a.joint_names, command, a.position, b.position, strict=True):
                found = Deviation(time, joint, q, q0 + share * (q1 - q0))
                if greatest is None or found.size > greatest.size:
                    greatest = found
        return greatest


def _line(message: Message) -> tuple[str, str] | None:
    match message:
        case ExecutorState():
            changed = ", the scene has changed" if message.scene_changed else ""
            return "robot", message.mode + changed + (f": {message.problem.code}" if message.problem else "")
        case GoalState():
            ended = f" at {message.progress:.0%} after {message.elapsed:.2f} s in motion" if message.done else ""
            return f"goal {message.goal_id}", message.status + ended + _reason(message.problem)
        case Strategies():
            return "strategy", message.active
        case Speed():
            return "speed", f"{message.speed_scale:.0%}"
        case Plan():
            samples = _counted(len(message.trajectory.time), "sample")
            return f"plan {message.plan_id}", f"{message.trajectory.duration:.2f} s, {samples}"
        case SceneEdited():
            return "scene", f"revision {message.revision}, {_counted(message.count, 'object')}"
        case StreamChunk(sequence=1):
            return f"stream {message.goal_id}", "begins"
        case DriverCommand(time=()):
            return "driver", "told to stop"
        case DriverCommand():
            return "driver", "told to move"
        case _:
            return None


def _reason(problem: Problem | None) -> str:
    return f": {problem.code}: {problem.message}" if problem else ""


def _counted(count: int, thing: str) -> str:
    return f"{count} {thing}" if count == 1 else f"{count} {thing}s"
