"""Replay of a record: a summary of it, or its messages on a bus."""

from __future__ import annotations

import itertools
import secrets
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zarm.connection import keys_of, opened
from zarm.interrupts import SLICE, CtrlC, Interrupts
from zarm.record_story import Story, robot_of, summarize
from zarm_contract.codec import decode
from zarm_contract.errors import InvalidRequest, Unavailable
from zarm_contract.keys import Keys
from zarm_contract.roles import Role
from zarm_runtime.bus import Bus, Publisher
from zarm_runtime.recorded import Recorded

if TYPE_CHECKING:
    from zarm_runtime.record import Entry

_LOOK_SECONDS = 1.0


def story(file: str | Path, *, interrupts: Interrupts | None = None) -> Story:
    """Summarise a record: its events, the number of messages, and which joint was furthest from its command. Raises
    InvalidRequest for a file that is not a record."""
    return summarize(_entries(Path(file), interrupts or CtrlC()))


def replay(
    file: str | Path,
    name: str,
    *,
    speed: float = 1.0,
    endpoint: str | None = None,
    role: Role | None = None,
    interrupts: Interrupts | None = None,
) -> int:
    """Republish a record as the robot `name`, at its own pace or `speed` times as fast. Returns the number of messages.

    Nothing moves: driver commands and stream chunks are left out. Raises Unavailable as soon as an executor of that
    robot is alive. Meanwhile none can start, because the replay holds its liveliness token.
    """
    if not speed > 0:
        raise InvalidRequest(f"{speed} is not a speed; give one above 0", field="speed")
    waits = interrupts or CtrlC()
    with opened(endpoint, role) as bus:
        return _publish(bus, keys_of(name), _entries(Path(file), waits), speed, waits)


def _entries(file: Path, interrupts: Interrupts) -> Iterator[Entry]:
    from zarm_runtime.record import read_record  # nothing else needs these libraries

    for entry in read_record(file):
        interrupts.check()
        yield entry


def _publish(bus: Bus, keys: Keys, entries: Iterator[Entry], speed: float, interrupts: Interrupts) -> int:
    if (first := next(entries, None)) is None:
        return 0
    began, source = first[0], Keys(robot_of(first[1]))
    recorded, moving = Recorded(source, scene=True), (source.driver_command, source.stream)
    place = _Place(bus, keys, interrupts)
    start = time.monotonic()
    publishers: dict[str, Publisher[Any]] = {}
    count = 0
    for stamp, key, payload in itertools.chain((first,), entries):
        place.hold_until(start + (stamp - began) / 1e9 / speed)
        published = recorded.key(key)
        if published is None or key in moving:
            continue
        try:
            message = decode(published.model, payload)
        except InvalidRequest:  # an invalid message, recorded as it was
            continue
        name = "/".join(("zarm", keys.robot, *key.split("/")[2:]))
        if name not in publishers:
            publishers[name] = bus.publisher(published.at(name))
        publishers[name].put(message)
        count += 1
    return count


class _Place:
    """Takes the place of a robot's executor on the bus. Raises Unavailable if there is one."""

    def __init__(self, bus: Bus, keys: Keys, interrupts: Interrupts) -> None:
        self._bus = bus
        self._keys = keys
        self._interrupts = interrupts
        # Sorts after every executor's, whatever the clocks say: of two owners the younger ends, which must be this one.
        self._me = f"replay{secrets.token_hex(4)}"
        self._next_look = 0.0
        bus.declare_alive(keys.alive("executor", self._me))

    def hold_until(self, due: float) -> None:
        """Wait until `due` (s on the monotonic clock). Raises Unavailable within a second after an executor appears."""
        while True:
            now = time.monotonic()
            if now >= self._next_look:
                self._look()
                self._next_look = now + _LOOK_SECONDS
            if now >= due:
                return
            self._interrupts.check()
            time.sleep(min(due - now, SLICE))

    def _look(self) -> None:
        alive = self._bus.alive(self._keys.alive("executor", "*"))
        if others := [instance for _, _, instance in alive if instance != self._me]:
            raise Unavailable(
                f"an executor of the robot {self._keys.robot} is alive (instance {others[0]}), and its robot is not where "
                "the record says; give it another name"
            )
