"""`zarm sensor`: the cameras that make the voxel map."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from zarm_cli.client import SIGNALS, AsJson, Connect, Name, connected
from zarm_cli.output import facts, numbers, out, print_json
from zarm_contract.camera import DescribedCamera
from zarm_contract.messages import CameraState, PerceptionState
from zarm_contract.section import read_section
from zarm_runtime.session import DEFAULT_ENDPOINT

_PERIOD = 1.0

app = typer.Typer(no_args_is_help=True, help="Show and change the depth cameras (`zarm up --perception`).")


@app.command("list")
def show(as_json: AsJson = False, connect: Connect = DEFAULT_ENDPOINT, name: Name = None) -> None:
    """List the cameras, and the voxel map that is made of them."""
    with connected(connect, name) as robot:
        cameras, state = robot.perception.cameras(), robot.perception.state()
    if as_json:
        print_json(state)
        return
    states = {one.name: one for one in state.cameras}
    table = Table("camera", "link", "position (m)", "pixels", "images", "age", "problem", box=None)
    for camera in cameras:
        one = states.get(camera.name, CameraState(name=camera.name))
        table.add_row(
            camera.name,
            camera.link or "base",
            numbers(camera.position),
            f"{camera.width} x {camera.height}",
            str(one.images),
            "-" if one.age is None else f"{one.age:.2f} s",
            one.problem or "-",
        )
    out.print(table if table.rows else "there are no cameras; add one with `zarm sensor add NAME FILE`")
    out.print(facts(*_map_facts(state)))


def _map_facts(state: PerceptionState) -> Iterator[tuple[str, str]]:
    yield "map", f"{numbers(state.lower)} to {numbers(state.upper)} m, voxels of {1000.0 * state.resolution:g} mm"
    yield "occupied", f"{state.occupied} voxels; unseen ones are {state.unseen}"
    yield "stale", "yes: a camera does not see any more" if state.stale else "no"


@app.command()
def add(
    camera: Annotated[str, typer.Argument(metavar="NAME")],
    file: Annotated[Path, typer.Argument(help="YAML file with the keys of a camera in a robot descriptor.")],
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """Add a depth camera, or replace the one with this name; its images come in on `perception/depth/NAME`."""
    _, described = read_section(file, "a camera", DescribedCamera)
    with connected(connect, name) as robot:
        count = len(robot.perception.add(described.message(camera)))
    out.print(f"{camera} is one of {count} cameras" if count > 1 else f"{camera} is the only camera")


@app.command()
def remove(
    camera: Annotated[str, typer.Argument(metavar="NAME")],
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """Remove a camera; what it has seen stays until `zarm sensor clear`."""
    with connected(connect, name) as robot:
        robot.perception.remove(camera)


@app.command()
def clear(connect: Connect = DEFAULT_ENDPOINT, name: Name = None) -> None:
    """Forget what the cameras have seen."""
    with connected(connect, name) as robot:
        robot.perception.clear()


@app.command()
def save(
    file: Annotated[Path, typer.Argument(help="File for the map; one that is there is replaced.")],
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """Save the voxel map."""
    with connected(connect, name) as robot:
        robot.perception.save(file)


@app.command()
def load(
    file: Annotated[Path, typer.Argument(help="File that `zarm sensor save` wrote.")],
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """Make a saved voxel map the map; cameras change it from then on."""
    with connected(connect, name) as robot:
        loaded = robot.perception.load(file)
    out.print(f"{loaded.occupied} voxels are occupied, {loaded.outside} of these outside the box of the map")


@app.command()
def watch(connect: Connect = DEFAULT_ENDPOINT, name: Name = None) -> None:
    """Print once a second what the cameras see, until Ctrl-C."""
    with connected(connect, name) as robot:
        while True:
            state = robot.perception.state()
            said = [f"{state.occupied} voxels occupied{', stale' if state.stale else ''}"]
            said += [
                f"{one.name}: {one.images} images, {100.0 * one.valid:.0f} % valid, {100.0 * one.robot:.0f} % robot, "
                f"{1000.0 * one.took:.1f} ms{f'; {one.problem}' if one.problem else ''}"
                for one in state.cameras
            ]
            out.print("; ".join(said))
            SIGNALS.run_interruptibly(lambda: time.sleep(_PERIOD))
