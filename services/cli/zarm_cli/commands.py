"""The commands of `zarm` by name, and how an error becomes one line and an exit code."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from importlib import import_module
from typing import Annotated

import typer

from zarm_cli.output import err, error_line, out
from zarm_contract.errors import Unavailable, ZarmError

REFUSED, USAGE, UNAVAILABLE = 1, 2, 3

MODULES = {
    "up": "launcher",
    "router": "router",
    "certs": "certs",
    "demo": "demo",
    "view": "view",
    "status": "status",
    "watch": "status",
    "health": "status",
    "plan": "planning",
    "execute": "execution",
    "program": "program",
    "gripper": "gripper",
    "output": "digital_outputs",
    "tool": "tool",
    "cancel": "execution",
    "speed": "execution",
    "strategy": "execution",
    "jog": "servoing",
    "track": "servoing",
    "fk": "kinematics",
    "ik": "kinematics",
    "check": "kinematics",
    "identify": "identify",
    "record": "record",
    "replay": "replay",
    "stop": "execution",
    "pause": "execution",
    "resume": "execution",
    "reset": "execution",
    "scene": "scene",
    "world": "world",
    "sensor": "sensor",
    "robot": "robot",
    "mcp": "mcp",
}
"""The module of each command. It holds a function of that name, or `app` if the command has subcommands."""


def run() -> int:
    """Run the command line; the exit code: 0 done, 1 refused, 2 usage, 3 unavailable, 130 interrupted."""
    try:
        code: int | None = command_line(_needed(sys.argv[1:2]))(standalone_mode=False)
        sys.stdout.flush()
    except ZarmError as error:
        err.print(error_line(error), soft_wrap=True)
        return UNAVAILABLE if isinstance(error, Unavailable) else REFUSED
    except typer.TyperException as error:
        if text := error.format_message():  # empty if the help was shown instead
            err.print(f"zarm: usage: {text} (`--help` shows how)", soft_wrap=True)
        return USAGE
    except (BrokenPipeError, SystemExit):  # the reader of the output has left, and has what it wanted
        return REFUSED
    except OSError as error:
        what = error.filename or "what is printed cannot be written"  # only an opened file is named
        err.print(f"zarm: failed: {what}: {error.strerror}", soft_wrap=True)
        return REFUSED
    return code or 0


def _needed(first: Sequence[str]) -> Iterable[str]:
    """The commands to load for a command line with this beginning: the named one, or all for help and unknown names."""
    if first == ["--version"]:
        return ()
    return [name for name in MODULES if name in first] or MODULES


def command_line(names: Iterable[str] = MODULES) -> typer.Typer:
    """The command line with these commands; loading all of them takes longer than most of them run."""
    app = typer.Typer(
        name="zarm",
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        help="Motion for robot arms. Start with `zarm demo`, or `zarm up` and then `zarm status` in a second terminal.",
    )
    app.callback()(_zarm)
    for name in names:
        module = import_module(f"zarm_cli.{MODULES[name]}")
        if hasattr(module, "app"):
            app.add_typer(module.app, name=name)
        else:
            app.command(name)(getattr(module, name))
    return app


def _show_version(wanted: bool) -> None:
    if wanted:
        from zarm_contract.codec import CONTRACT
        from zarm_runtime.version import version

        out.print(f"zarm {version()}, contract {CONTRACT}")
        raise typer.Exit


def _zarm(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version, and end.")
    ] = False,
) -> None:
    """What all commands have in common."""
