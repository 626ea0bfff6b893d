"""`zarm replay`: what a record tells, and its messages once more on a bus."""

from __future__ import annotations

import itertools
import secrets
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from zarm_cli.client import Connect, keys_of
from zarm_cli.interrupts import check, pause
from zarm_cli.output import counted, facts, out
from zarm_cli.story import Story, robot_of, tell
from zarm_contract.codec import decode
from zarm_contract.errors import InvalidRequest, Unavailable
from zarm_contract.keys import Keys
from zarm_runtime.bus import Bus, Publisher
from zarm_runtime.recorded import Recorded
from zarm_runtime.session import DEFAULT_ENDPOINT

_LOOK_SECONDS = 1.0


def replay(
    file: Annotated[Path, typer.Argument(help="A record: of `zarm record`, or of an executor that came to a fault.")],
    publish: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Instead: publish the messages again as those of the robot NAME, all but commands to a driver.",
        ),
    ] = None,
    speed: Annotated[float | None, typer.Option(help="How many times as fast as it was, with --publish.")] = None,
    connect: Connect = DEFAULT_ENDPOINT,
) -> None:
    """Tell what happened in a record, or publish it again."""
    if speed is not None and (publish is None or speed <= 0):
        raise typer.BadParameter("belongs to --publish, and is above 0", param_hint="--speed")
    if publish is None:
        _print(file, tell(_entries(file)))
        return
    with Bus(connect) as bus:
        count = _publish(bus, keys_of(publish), file, speed or 1.0)
    out.print(f"{counted(count, 'message')} of {file} published as {publish}", soft_wrap=True)


def _entries(file: Path) -> Iterator[tuple[int, str, bytes]]:
    from zarm_runtime.record import read_record  # no other command needs the libraries behind it

    for entry in read_record(file):
        check()
        yield entry


def _print(file: Path, story: Story) -> None:
    table = Table("time (s)", "", "", box=None)
    table.columns[0].justify = "right"
    for event in story.events:
        table.add_row(f"{event.time:.3f}", event.subject, event.what)
    counts, keys = story.counts, Keys(story.robot)
    rows = [
        ("record", str(file)),
        ("robot", story.robot),
        ("began", f"{datetime.fromtimestamp(story.began / 1e9, UTC):%Y-%m-%d %H:%M:%S.%f} UTC"),
        ("lasted", f"{story.lasted:.3f} s"),
        ("commands", f"{counts[keys.driver_command]} sent to a driver"),
        ("measured", counted(counts[keys.joint_states], "joint state")),
    ]
    if counts[keys.stream]:
        rows.append(("stream", counted(counts[keys.stream], "chunk")))
    if story.unreadable:
        rows.append(("unreadable", counted(story.unreadable, "message")))
    if (far := story.deviation) is not None:
        where = f"commanded {far.commanded:.4f}, measured {far.measured:.4f}"
        rows.append(("furthest off", f"{far.joint} by {far.size:.4f} rad at {far.time:.3f} s ({where})"))
    out.print(facts(*rows), "", table, sep="\n")


def _publish(bus: Bus, keys: Keys, file: Path, speed: float) -> int:
    """Publish the record as that of `keys`; how many messages.

    Raises Unavailable as soon as an executor of that robot is alive. Meanwhile none can start: the replay holds its place.
    What could move a robot is left out, whoever listens: commands to a driver and chunks of a stream.
    """
    entries = _entries(file)
    if (first := next(entries, None)) is None:
        return 0
    began, source = first[0], Keys(robot_of(first[1]))
    recorded, moving = Recorded(source), (source.driver_command, source.stream)
    place = _Place(bus, keys)
    start = time.monotonic()
    publishers: dict[str, Publisher[Any]] = {}
    count = 0
    for stamp, key, payload in itertools.chain((first,), entries):
        place.hold_until(start + (stamp - began) / 1e9 / speed)
        model = recorded.model(key)
        if model is None or key in moving:
            continue
        try:
            message = decode(model, payload)
        except InvalidRequest:  # noise that the record holds as it was
            continue
        name = "/".join(("zarm", keys.robot, *key.split("/")[2:]))
        if name not in publishers:
            publishers[name] = bus.publisher(name, model)
        publishers[name].put(message)
        count += 1
    return count


class _Place:
    """Holds the place of a robot's executor on the bus. Raises Unavailable where there is one."""

    def __init__(self, bus: Bus, keys: Keys) -> None:
        self._bus = bus
        self._keys = keys
        # Sorts behind every executor's, whatever the clocks say: of two owners the younger ends, and that is to be this one.
        self._me = f"replay{secrets.token_hex(4)}"
        self._next_look = 0.0
        bus.declare_alive(keys.alive("executor", self._me))

    def hold_until(self, due: float) -> None:
        """Wait until `due` (s on the monotonic clock). Raises Unavailable when an executor has come, a second later at most."""
        while True:
            now = time.monotonic()
            if now >= self._next_look:
                self._look()
                self._next_look = now + _LOOK_SECONDS
            if now >= due:
                return
            pause(min(due, self._next_look) - now)

    def _look(self) -> None:
        alive = self._bus.alive(self._keys.alive("executor", "*"))
        if others := [instance for _, _, instance in alive if instance != self._me]:
            raise Unavailable(
                f"an executor of the robot {self._keys.robot} is alive (instance {others[0]}), and its robot is not where "
                "the record says; give --publish another name"
            )
