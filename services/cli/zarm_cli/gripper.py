"""`zarm gripper`: opens and closes the grippers of a robot."""

from __future__ import annotations

from typing import Annotated

import typer

from zarm_cli.client import AsJson, Connect, Name, connected
from zarm_cli.output import facts, out, print_json
from zarm_contract.messages import GripperState
from zarm_runtime.session import DEFAULT_ENDPOINT

app = typer.Typer(no_args_is_help=True, help="Open and close grippers.")

Which = Annotated[str | None, typer.Option(help="Name of the gripper (default: the only one).")]
Force = Annotated[float | None, typer.Option(help="Greatest force of the fingers (N).")]
Speed = Annotated[float | None, typer.Option(help="Speed of the opening (m/s).")]
Preempt = Annotated[bool, typer.Option("--preempt", help="Cancel the goal that moves the gripper first.")]


@app.command("open")
def open_(
    gripper: Which = None,
    force: Force = None,
    speed: Speed = None,
    preempt: Preempt = False,
    as_json: AsJson = False,
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """Open a gripper as far as it goes. Ctrl-C stops the fingers."""
    with connected(connect, name) as robot:
        _show(robot.gripper.open(gripper, force=force, speed=speed, preempt=preempt), as_json)


@app.command()
def close(
    gripper: Which = None,
    force: Force = None,
    speed: Speed = None,
    preempt: Preempt = False,
    as_json: AsJson = False,
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """Close a gripper, until something stops the fingers."""
    with connected(connect, name) as robot:
        _show(robot.gripper.close(gripper, force=force, speed=speed, preempt=preempt), as_json)


@app.command()
def move(
    width: Annotated[float, typer.Argument(help="Opening between the pads (m).")],
    gripper: Which = None,
    force: Force = None,
    speed: Speed = None,
    preempt: Preempt = False,
    as_json: AsJson = False,
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """Move a gripper to an opening."""
    with connected(connect, name) as robot:
        _show(robot.gripper.move(width, gripper, force=force, speed=speed, preempt=preempt), as_json)


@app.command()
def cancel(
    gripper: Which = None, as_json: AsJson = False, connect: Connect = DEFAULT_ENDPOINT, name: Name = None
) -> None:
    """Stop a gripper where it is; it goes on holding what it holds."""
    with connected(connect, name) as robot:
        _show(robot.gripper.cancel(gripper), as_json)


@app.command()
def state(
    gripper: Which = None, as_json: AsJson = False, connect: Connect = DEFAULT_ENDPOINT, name: Name = None
) -> None:
    """Show how far a gripper is open, and what it does."""
    with connected(connect, name) as robot:
        _show(robot.gripper.state(gripper), as_json)


def _show(state: GripperState, as_json: bool) -> None:
    if as_json:
        print_json(state)
        return
    closed, opened = state.widths
    width = (
        "unknown: no driver reports it" if state.width is None else f"{state.width:.3f} m ({closed:g} to {opened:g})"
    )
    rows = [("gripper", state.gripper), ("status", state.status), ("opening", width)]
    if state.problem is not None:
        rows.append(("problem", state.problem.message))
    out.print(facts(*rows))
