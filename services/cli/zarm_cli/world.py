"""`zarm world`: the world of a simulation with physics."""

from __future__ import annotations

from typing import Annotated

import typer
from rich.table import Table

from zarm_cli.client import Connect, Name, connected
from zarm_cli.output import counted, out
from zarm_contract.world import WORLDS, read_world_file
from zarm_runtime.session import DEFAULT_ENDPOINT

app = typer.Typer(no_args_is_help=True, help="Worlds for robots with mass (`zarm up --driver physics`).")


@app.command("list")
def show() -> None:
    """List the worlds that come with zarm."""
    table = Table("name", "what it is", "objects", box=None)
    for path in sorted(WORLDS.glob("*.yaml")):
        _, world = read_world_file(path)
        table.add_row(path.stem, world.description, str(len(world.objects)))
    out.print(table)


@app.command()
def load(
    world: Annotated[str, typer.Argument(metavar="NAME|FILE", help="A world that comes with zarm, or a YAML file.")],
    scene: Annotated[
        bool, typer.Option("--scene/--no-scene", help="Also make it the scene, without what moves by itself.")
    ] = True,
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """Replace the world of a simulation: `zarm world load shelf`."""
    with connected(connect, name) as robot:
        count = robot.simulation.load(world, scene=scene)
    out.print(f"the world holds {counted(count, 'object')}")
