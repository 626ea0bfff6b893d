"""`zarm view`: a page in the browser for a running bus."""

from __future__ import annotations

import os
import sys
from importlib.util import find_spec
from typing import Annotated, NoReturn

import typer

from zarm_cli.client import Connect
from zarm_contract.errors import InvalidRequest, Unavailable
from zarm_runtime.session import DEFAULT_ENDPOINT

VIEW = "127.0.0.1:8017"
"""Default address of the page."""
VIEWER, EDITOR = "zarm_viewer.service", "zarm_viewer.editor"
_PACKAGES = ("viser", "trimesh", "collada", "websockets")


def view(
    robot: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[NAME=]DESCRIPTOR",
            help="A robot on the bus and its descriptor (default: every robot there whose descriptor comes with zarm).",
        ),
    ] = None,
    listen: Annotated[
        str,
        typer.Option(
            envvar="ZARM_VIEW",
            metavar="HOST:PORT",
            help="Address of the page; beyond loopback its URL has a token.",
        ),
    ] = VIEW,
    role: Annotated[
        str | None, typer.Option(help="operator, or viewer, which sees everything and moves nothing.")
    ] = None,
    connect: Connect = DEFAULT_ENDPOINT,
) -> None:
    """Serve a browser page that shows, plans and moves the robots on the bus. Ctrl-C ends the page, not a motion."""
    require_viewer()
    if role not in (None, "operator", "viewer"):
        raise InvalidRequest(f"{role} is neither operator nor viewer", field="--role")
    words = [word for each in robot or () for word in ("--robot", each)]
    words += ["--connect", connect, "--listen", listen]
    words += ["--role", role] if role else []
    serve(words)


def serve(words: list[str], page: str = VIEWER) -> NoReturn:
    """Become the viewer, or the editor of a robot, with these arguments."""
    sys.stdout.flush()
    os.execv(sys.executable, [sys.executable, "-P", "-m", page, *words])  # noqa: S606 - our own interpreter


def require_viewer() -> None:
    """Raise Unavailable if the packages of the page are not installed."""
    if missing := [package for package in _PACKAGES if find_spec(package) is None]:
        raise Unavailable(
            f"the page cannot be served, because {' and '.join(missing)} cannot be imported here; `pip install 'zarm[viewer]'` "
            "installs what is needed"
        )
