"""`zarm tool`: mounts the tools of a robot's descriptor."""

from __future__ import annotations

from typing import Annotated

import typer

from zarm_cli.client import AsJson, Connect, Name, connected
from zarm_cli.output import out, print_json, records
from zarm_cli.scene import print_edited
from zarm_runtime.session import DEFAULT_ENDPOINT

app = typer.Typer(no_args_is_help=True, help="Mount and change tools.")

Tool = Annotated[str, typer.Argument(metavar="TOOL", help="Its name in the robot's descriptor.")]


@app.command("list")
def list_(as_json: AsJson = False, connect: Connect = DEFAULT_ENDPOINT, name: Name = None) -> None:
    """List the tools that are mounted."""
    with connected(connect, name) as robot:
        attached = [one for one in robot.scene.read().attached if one.tool is not None]
    tools = {one.tool or "": one.link or "" for one in attached}
    if as_json:
        print_json({"tools": [{"name": tool, "link": link} for tool, link in tools.items()]})
        return
    out.print(records(("tool", "link"), [*tools.items()]) if tools else "No tool is mounted.")


@app.command()
def mount(tool: Tool, as_json: AsJson = False, connect: Connect = DEFAULT_ENDPOINT, name: Name = None) -> None:
    """Mount a tool, in place of the one on its link; the robot must stand still."""
    with connected(connect, name) as robot:
        print_edited(robot.scene.mount(tool), as_json)


@app.command()
def unmount(tool: Tool, as_json: AsJson = False, connect: Connect = DEFAULT_ENDPOINT, name: Name = None) -> None:
    """Take a tool off; the robot must stand still."""
    with connected(connect, name) as robot:
        print_edited(robot.scene.unmount(tool), as_json)
