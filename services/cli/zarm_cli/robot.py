"""`zarm robot`: list the robots of zarm, import one from a URDF, check and edit a descriptor."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from zarm_cli import checked, imported
from zarm_cli.client import AsJson
from zarm_cli.output import degrees, err, facts, numbers, out, print_json
from zarm_cli.view import EDITOR, VIEW, require_viewer, serve
from zarm_contract.errors import InvalidRequest, Unavailable
from zarm_contract.robot import ROBOTS, RobotDescription, load_robot

app = typer.Typer(no_args_is_help=True, help="Robot descriptors.")


@app.command("list")
def show() -> None:
    """List the robots that come with zarm."""
    for file in sorted(ROBOTS.glob("*.yaml")):
        out.print(file.stem)


class Geometry(StrEnum):
    """Which of a URDF's geometries is used."""

    auto = "auto"
    collision = "collision"
    visual = "visual"


@app.command("import")
def import_(
    file: Annotated[Path, typer.Argument(help="A URDF or xacro.", show_default=False)],
    name: Annotated[str | None, typer.Option(help="Name of the robot (default: as in the file).")] = None,
    base: Annotated[str | None, typer.Option(help="Base link of the arm (default: the root).")] = None,
    tip: Annotated[str | None, typer.Option(help="Link that goals refer to (default: the end of the arm).")] = None,
    joints: Annotated[
        str | None,
        typer.Option(metavar="A,B,C", help="The arm's joints, in order; others between them stand fixed."),
    ] = None,
    output: Annotated[Path | None, typer.Option(help="Folder for the files (default: the name).")] = None,
    packages: Annotated[
        list[Path] | None, typer.Option(metavar="FOLDER", help="Folder of ROS packages, for package:// and $(find).")
    ] = None,
    arg: Annotated[list[str] | None, typer.Option(metavar="NAME:=VALUE", help="An argument of the xacro.")] = None,
    fix: Annotated[
        list[str] | None,
        typer.Option(metavar="JOINT=POSITION", help="Fixed position of a joint outside the arm (rad, m)."),
    ] = None,
    geometry: Annotated[
        Geometry, typer.Option(help="auto: collision meshes, plus visual meshes that stick out of them.")
    ] = Geometry.auto,
    spheres: Annotated[int, typer.Option(min=10, max=400, help="Spheres in the cover of each arm.")] = 80,
    right_size: Annotated[
        list[str] | None, typer.Option(metavar="LINK", help="A link whose size is right, however large beside the arm.")
    ] = None,
    srdf: Annotated[
        Path | None,
        typer.Option(
            help="MoveIt's SRDF, for home and the names of groups and grippers (default: the one beside the URDF)."
        ),
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace a descriptor that is there already.")] = False,
) -> None:
    """Make a descriptor, a URDF of the arm alone, a report and a picture from any URDF or xacro."""
    chosen = imported.options(
        name=name,
        base=base,
        tip=tip,
        joints=tuple(one.strip() for one in joints.split(",")) if joints else (),
        packages=packages or (),
        arguments=dict(map(_argument, arg or ())),
        fixed=dict(map(_position, fix or ())),
        geometry=str(geometry),
        spheres=spheres,
        right_size=right_size or (),
        overwrite=overwrite,
        srdf=srdf,
    )
    descriptor, report = imported.run_import(file, output or Path(name or file.name.split(".")[0]), chosen)
    for warning in report.warnings:
        err.print(f"note: {warning}", soft_wrap=True)
    links = Table("link", "from", "exact: primitives, mean, largest", "cover: spheres, mean, largest", box=None)
    for surface, link in zip(report.surfaces, report.fitted, strict=True):
        links.add_row(
            link.link,
            surface.kind,
            f"{len(link.primitives)}  {_millimetres(link.exact_out.mean, link.exact_out.most)}",
            f"{len(link.balls)}  {_millimetres(link.cover_out.mean, link.cover_out.most)}",
        )
    assumed = sorted({what for limit in report.limits for what in limit.assumed})
    out.print(
        links,
        "",
        facts(
            (
                "robot",
                f"{report.name}, {len(report.chain.joints)} joints, {report.chain.base} to {' and '.join(report.chain.tips)}",
            ),
            *([("groups", ", ".join(group.name for group in report.chain.groups))] if report.chain.groups else []),
            *([("gripper", report.gripper_in_short)] if report.chain.gripper else []),
            ("spheres", str(report.spheres)),
            ("home", f"{numbers(report.home, 2)} rad"),
            *([("driver", f"{report.controller}, with strategy: joint_trajectory")] if report.controller else []),
            *([("assumed", f"{', '.join(assumed)}; see cspace in the descriptor")] if assumed else []),
            ("report", str(descriptor.with_suffix(".md"))),
            ("picture", str(descriptor.with_suffix(".png"))),
        ),
        "",
        sep="\n",
    )
    out.print(f"Next: zarm up --robot {descriptor}, or zarm robot edit {descriptor} to correct it", soft_wrap=True)


def _argument(text: str) -> tuple[str, str]:
    name, sign, value = text.partition(":=")
    if not name or not sign:
        raise InvalidRequest(f"{text!r} is no argument of a xacro; write --arg ur_type:=ur5e", field="--arg")
    return name, value


def _position(text: str) -> tuple[str, float]:
    joint, _, value = text.rpartition("=")
    try:
        return joint, float(value)
    except ValueError:
        raise InvalidRequest(
            f"{text!r} is no position of a joint; write --fix finger_joint=0.04", field="--fix"
        ) from None


def _millimetres(mean: float, most: float) -> str:
    return f"{1e3 * mean:.1f}, {1e3 * most:.0f} mm"


@app.command()
def compose(
    file: Annotated[Path, typer.Argument(help="A composition file (.yaml).", show_default=False)],
    output: Annotated[Path | None, typer.Option(help="Folder for the files (default: the robot's name).")] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace a descriptor that is there already.")] = False,
) -> None:
    """Make one robot of several: arms side by side, or on a torso or an axis."""
    descriptor = imported.run_compose(file, output, overwrite)
    robot = load_robot(str(descriptor))
    out.print(
        facts(
            ("robot", f"{robot.descriptor.name}, {len(robot.descriptor.joints)} joints"),
            ("groups", ", ".join(robot.descriptor.groups)),
            *([("grippers", ", ".join(robot.descriptor.grippers))] if robot.descriptor.grippers else []),
        )
    )
    out.print(f"Next: zarm robot check {descriptor}, then zarm up --robot {descriptor}", soft_wrap=True)


@app.command()
def check(
    robot: Annotated[
        str, typer.Argument(metavar="FILE", help="A descriptor (.yaml), or the name of a robot that comes with zarm.")
    ],
    calibrate: Annotated[
        list[str] | None,
        typer.Option(
            metavar="JOINTS=POSE",
            help="Joint positions (rad) and the tip measured there: x,y,z (m) or x,y,z,qx,qy,qz,qw.",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Show what a descriptor contains, or list every fault with its place and remedy."""
    try:
        loaded = load_robot(robot)
        found = _findings(loaded)
        compared = checked.compare(loaded, calibrate) if calibrate else None
    except InvalidRequest as error:
        if as_json:
            print_json({"ok": False, "faults": error.problem.message.splitlines()})
        else:
            err.print(error.problem.message, soft_wrap=True)
        raise typer.Exit(1) from None
    ok = not found and (compared is None or compared.fits)
    if as_json:
        described = {"hash": loaded.hash, "robot": loaded.descriptor.model_dump(mode="json")}
        print_json(
            {"ok": ok, "faults": found, **described, **({"calibration": compared.as_dict()} if compared else {})}
        )
    else:
        _describe(loaded)
        for note in loaded.urdf.notes:
            err.print(f"note: {note}", soft_wrap=True)
        for fault in found:
            err.print(f"{loaded.path}: {fault}", soft_wrap=True)
        if compared:
            for line in compared.lines():
                (out if compared.fits else err).print(line, soft_wrap=True)
    if not ok:
        raise typer.Exit(1)


@app.command()
def edit(
    file: Annotated[Path, typer.Argument(help="A descriptor (.yaml).", show_default=False)],
    listen: Annotated[
        str,
        typer.Option(
            metavar="HOST:PORT",
            help="Address of the page; beyond loopback its URL has a token.",
        ),
    ] = VIEW,
) -> None:
    """Serve a page to correct spheres, link pairs and home; Ctrl-C ends it."""
    require_viewer()
    if not file.is_file():
        raise InvalidRequest(
            f"there is no robot descriptor at {file}; a robot that comes with zarm is corrected in a copy"
        )
    serve([str(file), "--listen", listen], EDITOR)


def _findings(robot: RobotDescription) -> list[str]:
    """Faults of the geometry; reported as unknown if the packages that check it are missing."""
    try:
        return checked.findings(robot)
    except Unavailable as error:
        err.print(f"note: the geometry was not looked at: {error.problem.message}", soft_wrap=True)
        return []


def _describe(robot: RobotDescription) -> None:
    descriptor = robot.descriptor
    out.print(
        facts(
            ("robot", descriptor.name),
            ("chain", f"{descriptor.base_link} to {descriptor.tip_link} in {robot.urdf_path}"),
            ("home", f"{numbers(descriptor.home, 4)} rad = {degrees(descriptor.home)} deg"),
            *([("groups", ", ".join(descriptor.groups))] if descriptor.groups else []),
            *([("tools", ", ".join(descriptor.tools))] if descriptor.tools else []),
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
        limits.add_row(joint, *(numbers((value,)) if math.isfinite(value) else "none" for value in row))
    links = Table("link", "spheres", "exact primitives", box=None)
    for link, spheres in descriptor.spheres.items():
        links.add_row(link, str(len(spheres)), _counted(one.kind for one in descriptor.collision[link]))
    out.print("", limits, "", links, sep="\n")


def _counted(kinds: Iterable[str]) -> str:
    return ", ".join(f"{count} {kind}" for kind, count in Counter(kinds).items())
