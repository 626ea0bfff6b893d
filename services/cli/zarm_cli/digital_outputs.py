"""`zarm output`: switches the digital outputs of a robot."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import typer

from zarm_cli.client import AsJson, Connect, Name, connected
from zarm_cli.output import out, print_json, records
from zarm_contract.messages import OutputState
from zarm_runtime.session import DEFAULT_ENDPOINT

app = typer.Typer(no_args_is_help=True, help="Switch digital outputs.")


class Level(StrEnum):
    """What an output can be."""

    ON = "on"
    OFF = "off"


@app.command("set")
def set_(
    output: Annotated[str, typer.Argument(help="Name of the output in the robot's descriptor.")],
    level: Annotated[Level, typer.Argument(help="Whether it is to be on.")],
    as_json: AsJson = False,
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """Switch an output on or off, and wait until its driver has done so."""
    with connected(connect, name) as robot:
        _show([robot.outputs.set(output, level is Level.ON)], as_json)


@app.command("list")
def list_(as_json: AsJson = False, connect: Connect = DEFAULT_ENDPOINT, name: Name = None) -> None:
    """List the outputs, and how each was switched last."""
    with connected(connect, name) as robot:
        _show(list(robot.outputs.all().values()), as_json)


def _show(states: list[OutputState], as_json: bool) -> None:
    if as_json:
        print_json({"outputs": states})
        return
    rows = [(state.output, level(state), "" if state.problem is None else state.problem.message) for state in states]
    out.print(
        records(("output", "state", "problem"), rows)
        if rows
        else "The robot has no outputs: its descriptor names none."
    )


def level(state: OutputState) -> str:
    """How it was switched last."""
    return "unknown" if state.on is None else "on" if state.on else "off"
