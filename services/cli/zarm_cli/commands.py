"""The command line of `zarm`: its commands by name, and how an error becomes one line and an exit code."""

from __future__ import annotations

import sys

import typer

from zarm_cli import (
    certs,
    demo,
    execution,
    kinematics,
    launcher,
    planning,
    record,
    replay,
    robot,
    router,
    scene,
    status,
)
from zarm_cli.output import err, error_line
from zarm_contract.errors import Unavailable, ZarmError

REFUSED, USAGE, UNAVAILABLE = 1, 2, 3

app = typer.Typer(
    name="zarm",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Motion for robot arms. Start with `zarm demo`, or `zarm up` and then `zarm status` in a second terminal.",
)
for command in (
    launcher.up,
    router.router,
    certs.certs,
    demo.demo,
    status.status,
    status.watch,
    status.health,
    planning.plan,
    execution.execute,
    execution.cancel,
    execution.speed,
    execution.strategy,
    kinematics.fk,
    kinematics.ik,
    kinematics.check,
    record.record,
    replay.replay,
):
    app.command()(command)
for name, order in execution.ORDERS.items():
    app.command(name)(order)
app.add_typer(scene.app, name="scene")
app.add_typer(robot.app, name="robot")


def run() -> int:
    """Run the command line; the exit code: 0 done, 1 refused, 2 usage, 3 unavailable, 130 interrupted."""
    try:
        code: int | None = app(standalone_mode=False)
        sys.stdout.flush()
    except ZarmError as error:
        err.print(error_line(error), soft_wrap=True)
        return UNAVAILABLE if isinstance(error, Unavailable) else REFUSED
    except typer.TyperException as error:
        if text := error.format_message():  # empty where the help was shown instead
            err.print(f"zarm: usage: {text} (`--help` shows how)", soft_wrap=True)
        return USAGE
    except (BrokenPipeError, SystemExit):  # whoever reads the output has left, and has what they wanted
        return REFUSED
    except OSError as error:
        what = error.filename or "what is printed cannot be written"  # only a file that is opened is named
        err.print(f"zarm: failed: {what}: {error.strerror}", soft_wrap=True)
        return REFUSED
    return code or 0
