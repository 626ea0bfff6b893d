"""`zarm robot`: the robots that zarm brings, and what is wrong with a descriptor."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import Annotated

import typer
from rich.table import Table

from zarm_cli.client import AsJson
from zarm_cli.output import degrees, err, facts, numbers, out, print_json
from zarm_contract.errors import InvalidRequest
from zarm_contract.robot import ROBOTS, RobotDescription, load_robot

app = typer.Typer(no_args_is_help=True, help="Robot descriptors.")


@app.command("list")
def show() -> None:
    """List the robots that come with zarm."""
    for file in sorted(ROBOTS.glob("*.yaml")):
        out.print(file.stem)


@app.command()
def check(
    robot: Annotated[
        str, typer.Argument(metavar="FILE", help="A descriptor (.yaml), or the name of a robot that comes with zarm.")
    ],
    as_json: AsJson = False,
) -> None:
    """Show what a descriptor contains, or list every fault with file and line."""
    try:
        loaded = load_robot(robot)
    except InvalidRequest as error:
        if as_json:
            print_json({"ok": False, "faults": error.problem.message.splitlines()})
        else:
            err.print(error.problem.message, soft_wrap=True)
        raise typer.Exit(1) from None
    if as_json:
        print_json({"ok": True, "hash": loaded.hash, "robot": loaded.descriptor.model_dump(mode="json")})
    else:
        _describe(loaded)


def _describe(robot: RobotDescription) -> None:
    descriptor = robot.descriptor
    out.print(
        facts(
            ("robot", descriptor.name),
            ("chain", f"{descriptor.base_link} to {descriptor.tip_link} in {robot.urdf_path}"),
            ("home", f"{numbers(descriptor.home, 4)} rad = {degrees(descriptor.home)} deg"),
            ("strategy", descriptor.strategy),
            ("hash", robot.hash),
        )
    )
    limits = Table("joint", "lower (rad)", "upper (rad)", "rad/s", "rad/s²", "rad/s³", box=None)
    columns = (
        robot.lower,
        robot.upper,
        descriptor.cspace.velocity,
        descriptor.cspace.acceleration,
        descriptor.cspace.jerk,
    )
    for joint, *row in zip(descriptor.joints, *columns, strict=True):
        limits.add_row(joint, *(numbers((value,)) for value in row))
    links = Table("link", "spheres", "exact primitives", box=None)
    for link, spheres in descriptor.spheres.items():
        links.add_row(link, str(len(spheres)), _counted(one.kind for one in descriptor.collision[link]))
    out.print("", limits, "", links, sep="\n")


def _counted(kinds: Iterable[str]) -> str:
    return ", ".join(f"{count} {kind}" for kind, count in Counter(kinds).items())
