"""`zarm replay`: prints what a record holds, and publishes its messages again."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from zarm.record_story import Story
from zarm.replaying import replay as publish_again
from zarm.replaying import story
from zarm_cli.client import SIGNALS, Connect, keys_of
from zarm_cli.output import counted, facts, out
from zarm_cli.view import require_viewer, serve
from zarm_contract.keys import Keys
from zarm_runtime.session import DEFAULT_ENDPOINT


def replay(
    file: Annotated[Path, typer.Argument(help="A file of `zarm record`, or of the flight recorder of an executor.")],
    publish: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Republish the messages as the robot NAME, except driver commands and streams.",
        ),
    ] = None,
    speed: Annotated[float | None, typer.Option(help="With --publish: playback speed factor.")] = None,
    view: Annotated[bool, typer.Option("--view", help="Play it in the browser.")] = False,
    robot: Annotated[
        str | None,
        typer.Option(
            metavar="DESCRIPTOR",
            help="With --view: the robot's descriptor (default: the one with its name that comes with zarm).",
        ),
    ] = None,
    connect: Connect = DEFAULT_ENDPOINT,
) -> None:
    """Summarise a record, play it in the browser, or republish its messages."""
    if view and publish is not None:
        raise typer.BadParameter("does not go with --publish", param_hint="--view")
    if robot is not None and not view:
        raise typer.BadParameter("belongs to --view", param_hint="--robot")
    if speed is not None and (publish is None or speed <= 0):
        raise typer.BadParameter("belongs to --publish, and is above 0", param_hint="--speed")
    if view:
        require_viewer()
        serve(["--record", str(file), *(("--robot", robot) if robot else ())])
    if publish is None:
        _print(file, story(file, interrupts=SIGNALS))
        return
    count = publish_again(file, keys_of(publish).robot, speed=speed or 1.0, endpoint=connect, interrupts=SIGNALS)
    out.print(f"{counted(count, 'message')} of {file} published as {publish}", soft_wrap=True)


def _print(file: Path, summary: Story) -> None:
    table = Table("time (s)", "", "", box=None)
    table.columns[0].justify = "right"
    for event in summary.events:
        table.add_row(f"{event.time:.3f}", event.subject, event.what)
    counts, keys = summary.counts, Keys(summary.robot)
    rows = [
        ("record", str(file)),
        ("robot", summary.robot),
        ("began", f"{datetime.fromtimestamp(summary.began / 1e9, UTC):%Y-%m-%d %H:%M:%S.%f} UTC"),
        ("lasted", f"{summary.lasted:.3f} s"),
        ("commands", f"{counts[keys.driver_command]} sent to a driver"),
        ("measured", counted(counts[keys.joint_states], "joint state")),
    ]
    if counts[keys.stream]:
        rows.append(("stream", counted(counts[keys.stream], "chunk")))
    if summary.unreadable:
        rows.append(("unreadable", counted(summary.unreadable, "message")))
    if (far := summary.deviation) is not None:
        where = f"commanded {far.commanded:.4f}, measured {far.measured:.4f}"
        rows.append(("furthest off", f"{far.joint} by {far.size:.4f} rad at {far.time:.3f} s ({where})"))
    out.print(facts(*rows), "", table, sep="\n")
