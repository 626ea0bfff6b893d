"""`zarm record`: writes the messages of a robot to a file."""

from __future__ import annotations

import math
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer

from zarm_cli.client import Connect, Name, connected
from zarm_cli.output import counted, err, out
from zarm_runtime.session import DEFAULT_ENDPOINT


def record(
    file: Annotated[Path | None, typer.Argument(help="The file (default: <robot>_<UTC time>.mcap, here).")] = None,
    seconds: Annotated[float | None, typer.Option(min=0, help="How long to record (s; default: until Ctrl-C).")] = None,
    scene: Annotated[
        bool,
        typer.Option("--scene", help="Record the scene, the voxel map and a simulation too, which the page shows."),
    ] = False,
    images: Annotated[
        bool, typer.Option("--images", help="Record the images of the cameras too, which Foxglove shows.")
    ] = False,
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """Record the robot's messages to an MCAP file, until Ctrl-C. Foxglove and `zarm replay` open it."""
    with connected(connect, name) as robot:
        path = file or Path(f"{robot.name}_{datetime.now(UTC):%Y%m%dT%H%M%S}Z.mcap")
        with robot.record(path, scene=scene, images=images) as recorder, suppress(KeyboardInterrupt):  # the usual end
            err.print(f"recording {robot.name} to {path}; Ctrl-C ends it", soft_wrap=True)
            recorder.wait(math.inf if seconds is None else seconds)
    lost = f", {recorder.lost} lost" if recorder.lost else ""
    out.print(f"{counted(recorder.count, 'message')} in {path}{lost}", soft_wrap=True)
