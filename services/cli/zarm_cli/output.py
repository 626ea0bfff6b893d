"""What the commands print: results on standard output, progress and errors on standard error."""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Mapping, Sequence

from rich.console import Console
from rich.measure import Measurement
from rich.table import Table

from zarm_contract.codec import encode
from zarm_contract.errors import ZarmError
from zarm_contract.messages import GoalState, Hold, Message, Pose


def _width() -> int | None:
    """Columns of standard output, None if it is a terminal, which knows its width. A pipe gets a readable width;
    programs set COLUMNS to 80 by default, so only smaller values are respected.
    """
    columns = os.environ.get("COLUMNS", "")
    if sys.stdout.isatty():
        return None
    return int(columns) if columns.isdecimal() and 0 < int(columns) < 80 else 120


# Output is never markup, because messages contain brackets.
out = Console(highlight=False, markup=False, width=_width())
err = Console(highlight=False, markup=False, stderr=True)

SCENE_CHANGED = (
    "the scene has changed since this motion was checked: stop it, and plan again, if something is in its way"
)


def held_by(hold: Hold) -> str:
    """Why a goal is held, in a sentence without its full stop."""
    found = hold.obstruction
    if hold.reason == "gripper":
        return "its gripper moves"
    if hold.reason == "output":
        return "an output is being switched"
    if found is None:
        return "no servo guards it, and the descriptor demands one"
    late = "" if found.avoidable else ", and contact could not be avoided any more"
    return f"{found.object} is in the way of {found.link} at {found.time:.2f} s of the trajectory{late}"


def reached(goal: GoalState) -> str:
    """How far a goal is in its trajectory; at less than full speed that is less than the time in motion."""
    return f"{goal.progress * goal.duration:.1f} of {goal.duration:.1f} s"


def print_json(value: Message | Mapping[str, object]) -> None:
    """A line of JSON: one message as it goes over the bus, or several by name."""
    line = encode(value).decode() if isinstance(value, Message) else json.dumps(value, default=_plain)
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def _plain(value: object) -> object:
    if isinstance(value, Message):
        return json.loads(encode(value))
    raise TypeError(f"{value!r} has no JSON form")


def error_line(error: ZarmError) -> str:
    """An error as one line: `zarm: <code>: <sentence>`."""
    first, *more = str(error).splitlines()
    rest = f" (and {len(more)} more)" if more else ""
    return f"zarm: {error.code}: {first}{rest}"


def numbers(values: Sequence[float], digits: int = 3) -> str:
    """`0.559, 0.034, 0.651`."""
    return ", ".join(f"{round(value, digits) + 0.0:.{digits}f}" for value in values)


def counted(count: int, thing: str) -> str:
    """`1 object`, `2 objects`."""
    return f"{count} {thing}" if count == 1 else f"{count} {thing}s"


def degrees(values: Sequence[float]) -> str:
    """Angles in rad as `30.0, -45.0`, in degrees."""
    return numbers([math.degrees(value) for value in values], 1)


def share_text(scale: float) -> str:
    """A share of the planned speed as `20% of the planned speed`."""
    return f"{100 * scale:g}% of the planned speed"


def pose_text(pose: Pose) -> str:
    """A pose as `x, y, z m   qx, qy, qz, qw (x, y, z, w)`."""
    return f"{numbers(pose.position)} m   {numbers(pose.orientation)} (x, y, z, w)"


def facts(*rows: tuple[str, str]) -> Table:
    """A table of names and values."""
    table = Table.grid(padding=(0, 2))
    table.add_column(style="dim", no_wrap=True)
    table.add_column()
    for row in rows:
        table.add_row(*row)
    return table


def records(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    """A table with one line for each row; on a terminal too narrow for that, one fact per line."""
    table = Table(*columns, box=None)
    for row in rows:
        table.add_row(*row)
    unbounded = out.options.update(max_width=10_000)
    if Measurement.get(out, unbounded, table).maximum <= out.width:
        return table
    return facts(*(fact for row in rows for fact in (*zip(columns, row, strict=False), ("", ""))))
