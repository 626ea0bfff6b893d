"""`zarm sensor`: the cameras that make the voxel map."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
import yaml
from rich.table import Table

from zarm_cli.client import SIGNALS, AsJson, Connect, Name, connected
from zarm_cli.output import facts, numbers, out, print_json
from zarm_contract.camera import DescribedCamera
from zarm_contract.errors import InvalidRequest, Unavailable
from zarm_contract.messages import Camera, CameraState, PerceptionState
from zarm_contract.section import read_section
from zarm_runtime.session import DEFAULT_ENDPOINT

if TYPE_CHECKING:
    from zarm_hand_eye import Board

_PERIOD = 1.0

Columns = Annotated[int, typer.Option(help="Squares in a row of the board.")]
Rows = Annotated[int, typer.Option(help="Rows of squares.")]
Square = Annotated[float, typer.Option(help="Edge of a square (m).")]
Marker = Annotated[float, typer.Option(help="Edge of a marker (m).")]
Dictionary = Annotated[str, typer.Option(metavar="NAME", help="OpenCV's dictionary of markers.")]

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


@app.command()
def board(
    file: Annotated[Path, typer.Argument(help="PNG file for the board; one that is there is replaced.")],
    columns: Columns = 7,
    rows: Rows = 5,
    square: Square = 0.04,
    marker: Marker = 0.03,
    dictionary: Dictionary = "DICT_4X4_50",
) -> None:
    """Draw the ChArUco board that `zarm sensor calibrate` looks at, to be printed (`zarm[calibration]`)."""
    drawn = _board(columns, rows, square, marker, dictionary)
    try:
        file.write_bytes(drawn.picture())
    except OSError as error:
        raise InvalidRequest(f"{file}: {error.strerror}; name a file that can be written", field="FILE") from error
    width, height = (1000.0 * edge for edge in drawn.size)
    out.print(f"{file}: print it {width:g} mm wide and {height:g} mm high, on something flat; then measure a square")


@app.command()
def calibrate(
    camera: Annotated[str, typer.Argument(metavar="NAME")],
    board_link: Annotated[
        str | None,
        typer.Option(metavar="LINK", help="The link that carries the board, for a camera that is not on the arm."),
    ] = None,
    views: Annotated[int, typer.Option(min=5, max=100, help="Poses from which the board is seen.")] = 15,
    velocity_scale: Annotated[
        float, typer.Option(min=0.01, max=1.0, help="Fraction of the joint limits of velocity.")
    ] = 0.5,
    file: Annotated[
        Path | None, typer.Option("--write", metavar="FILE", help="Write the camera, as `zarm sensor add` takes it.")
    ] = None,
    columns: Columns = 7,
    rows: Rows = 5,
    square: Square = 0.04,
    marker: Marker = 0.03,
    dictionary: Dictionary = "DICT_4X4_50",
    as_json: AsJson = False,
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """Find out where a camera is: the robot moves, and the camera looks at a printed board.

    A camera on a link of the arm looks at a board that stands still; another one at a board on the arm. It sees the board at the start, and is
    declared about where it is (`zarm sensor add`).
    """
    seen = _board(columns, rows, square, marker, dictionary)
    from zarm_hand_eye import calibrate as calibrated

    with connected(connect, name) as robot:
        found = calibrated(
            robot,
            camera,
            seen,
            views=views,
            board_link=board_link,
            velocity_scale=velocity_scale,
            report=(lambda _: None) if as_json else out.print,
        )
    if file is not None:
        _write(file, found.camera)
    if as_json:
        print_json(found.camera)
        return
    out.print(
        facts(
            ("frame", found.camera.link or "base"),
            ("position", f"{numbers(found.camera.position, 5)} m"),
            ("orientation", f"{numbers(found.camera.orientation, 5)} (x, y, z, w)"),
            ("views", str(found.views)),
            ("reprojection", f"error of {found.reprojection_error:.2f} pixels (RMS)"),
            ("deviation", f"{1000.0 * found.position_std:.2f} mm, {math.degrees(found.angle_std):.3f} deg"),
        )
    )


def _board(columns: int, rows: int, square: float, marker: float, dictionary: str) -> Board:
    try:
        from zarm_hand_eye import Board
    except ImportError as error:
        raise Unavailable(f"{error.name} is not installed: pip install 'zarm[planner,calibration]'") from error
    return Board(columns, rows, square, marker, dictionary)


def _write(file: Path, camera: Camera) -> None:
    described = camera.model_dump(mode="json", exclude={"name"}, exclude_none=True)
    try:
        file.write_text(yaml.safe_dump(described, sort_keys=False, default_flow_style=None))
    except OSError as error:
        raise InvalidRequest(f"{file}: {error.strerror}; name a file that can be written", field="--write") from error
