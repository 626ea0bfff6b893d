"""`zarm mcp`: tools for agents."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from zarm_cli.client import Connect, Name
from zarm_contract.errors import Unavailable
from zarm_runtime.session import DEFAULT_ENDPOINT


def mcp(
    robot: Annotated[str, typer.Option(metavar="NAME|FILE", help="Robot descriptor.")] = "doosan_m1013",
    policy: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="What the agent may do; by default slowly, each motion approved by a person."
        ),
    ] = None,
    http: Annotated[
        str | None, typer.Option(metavar="HOST:PORT", help="Serve over HTTP instead of stdin and stdout.")
    ] = None,
    twin: Annotated[
        str | None,
        typer.Option(
            metavar="ENDPOINT", help="The router of a twin, `zarm up --driver physics`, that makes each motion first."
        ),
    ] = None,
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """Serve tools to an agent over the Model Context Protocol, inside a policy."""
    try:
        from zarm_mcp.service import serve
    except ImportError as error:
        raise Unavailable("`zarm mcp` needs the extra `mcp`; install `zarm[mcp]`") from error
    serve(robot, policy, http, connect, name, twin)
