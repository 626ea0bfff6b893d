"""`zarm scene`: what the planner keeps clear of."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Literal

import typer
import yaml
from rich.table import Table

from zarm_cli.client import AsJson, Client, Connect, Name, connected, floats, joints, message
from zarm_cli.output import counted, numbers, out, print_json
from zarm_cli.planning import read_bytes, write_text
from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import Scene, SceneEdit, SceneEdited, Voxels
from zarm_runtime.session import DEFAULT_ENDPOINT

app = typer.Typer(no_args_is_help=True, help="Show and change the objects that motions are planned around.")


@app.command("list")
def show(as_json: AsJson = False, connect: Connect = DEFAULT_ENDPOINT, name: Name = None) -> None:
    """List the objects, what the robot carries, and the links that are not looked at."""
    scene = _read(connect, name)
    if as_json:
        print_json(scene)
        return
    table = Table("name", "kind", "position (m)", "orientation (x, y, z, w)", "dimensions (m)", box=None)
    for one in (*scene.objects, *(carried.object for carried in scene.attached)):
        fields = one.model_dump(exclude={"kind", "name", "position", "orientation", "sha256"})
        if isinstance(one, Voxels):
            fields["cells"] = len(one.cells)
        table.add_row(
            one.name,
            one.kind,
            numbers(one.position),
            numbers(getattr(one, "orientation", ())),
            ", ".join(f"{key} {_shown(value)}" for key, value in fields.items()),
        )
    out.print(table if table.rows else "the scene is empty")
    for carried in scene.attached:
        touches = f"; it may touch {', '.join(carried.touch_links)}" if carried.touch_links else ""
        out.print(f"the robot carries {carried.object.name}, placed from its tip{touches}")
    if scene.ignored_links:
        out.print(f"links that are not looked at: {', '.join(scene.ignored_links)}")
    out.print(f"revision {scene.revision}")


def _shown(value: object) -> str:
    if isinstance(value, tuple | float):
        return numbers(value if isinstance(value, tuple) else (value,))
    return str(value)


@app.command()
def add(
    kind: Annotated[Literal["cuboid", "sphere", "capsule", "cylinder", "mesh"], typer.Argument()],
    object_name: Annotated[str, typer.Argument(metavar="NAME")],
    at: Annotated[str, typer.Option(metavar="X,Y,Z[,QX,QY,QZ,QW]", help="Pose of its centre in the base frame (m).")],
    size: Annotated[str | None, typer.Option(metavar="X,Y,Z", help="Edge lengths of a cuboid (m).")] = None,
    radius: Annotated[float | None, typer.Option(help="Of a sphere, capsule or cylinder (m).")] = None,
    length: Annotated[float | None, typer.Option(help="Of a capsule or cylinder, along its own z (m).")] = None,
    file: Annotated[
        str | None, typer.Option(help="Of a mesh: an STL or OBJ file (m), as named in a mesh folder of the planner's.")
    ] = None,
    scale: Annotated[
        str | None, typer.Option(metavar="S or X,Y,Z", help="Of a mesh: what its file is multiplied by; 0.001 for mm.")
    ] = None,
    replace: Annotated[bool, typer.Option("--replace", help="Take the place of an object of that name.")] = False,
    as_json: AsJson = False,
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """Add an object: `zarm scene add cuboid table --at 0.5,0,0.2 --size 1,1,0.02`."""
    pose = floats(at, "--at", 3, 7)
    factors = None if scale is None else floats(scale, "--scale", 1, 3)
    fields = {
        "kind": kind,
        "name": object_name,
        "position": pose[:3],
        "orientation": pose[3:] or None,
        "size": None if size is None else floats(size, "--size", 3),
        "radius": radius,
        "length": length,
        "file": file,
        "scale": factors and (factors * 3)[:3],
    }
    thing = {key: value for key, value in fields.items() if value is not None}
    _edit(connect, name, as_json, op="add", objects=[thing], replace=replace)


@app.command()
def remove(
    names: Annotated[list[str], typer.Argument(metavar="NAME...")],
    as_json: AsJson = False,
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """Remove objects by name."""
    _edit(connect, name, as_json, op="remove", names=names)


@app.command()
def clear(as_json: AsJson = False, connect: Connect = DEFAULT_ENDPOINT, name: Name = None) -> None:
    """Remove every object."""
    _edit(connect, name, as_json, op="clear")


At = Annotated[
    str | None,
    typer.Option("--joints", metavar="A,B,C,...", help="Where the robot is (rad); left out: the measured joints."),
]


@app.command()
def attach(
    object_name: Annotated[str, typer.Argument(metavar="NAME")],
    touch: Annotated[
        list[str] | None, typer.Option(metavar="LINK", help="A link that it may touch; repeatable.")
    ] = None,
    at: At = None,
    as_json: AsJson = False,
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """From now on the robot carries an object: `zarm scene attach box --touch link_5`."""
    where = joints(at, "--joints")
    _edit(connect, name, as_json, op="attach", name=object_name, touch_links=touch or [], joints=where)


@app.command()
def detach(
    object_name: Annotated[str, typer.Argument(metavar="NAME")],
    at: At = None,
    as_json: AsJson = False,
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """Put down what the robot carries, where it is now."""
    _edit(connect, name, as_json, op="detach", name=object_name, joints=joints(at, "--joints"))


@app.command()
def links(
    names: Annotated[list[str], typer.Argument(metavar="LINK...")],
    enabled: Annotated[bool, typer.Option("--on/--off", help="Look at their collisions, or no longer.")],
    as_json: AsJson = False,
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """Switch the collisions of links of the robot off, and on again: `zarm scene links link_6 --off`."""
    _edit(connect, name, as_json, op="links", names=names, enabled=enabled)


@app.command()
def load(
    file: Annotated[Path, typer.Argument(help="YAML: `objects`, a list with the fields that `scene save` writes.")],
    as_json: AsJson = False,
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """Replace the whole scene by that of a file."""
    objects = _read_objects(file)
    try:
        edit = message(SceneEdit, edit={"op": "load", "objects": objects})
    except InvalidRequest as error:
        field = error.problem.field
        raise InvalidRequest(f"{file}: {error.problem.message}", field=field and field.removeprefix("edit.")) from error
    with connected(connect, name) as client:
        _apply(client, edit, as_json)


@app.command()
def save(file: Path, connect: Connect = DEFAULT_ENDPOINT, name: Name = None) -> None:
    """Write the objects of the scene to a YAML file that `scene load` reads; what the robot carries is not among them."""
    scene = _read(connect, name)
    objects = json.loads(scene.model_dump_json(include={"objects"}))
    write_text(file, yaml.safe_dump(objects, sort_keys=False, default_flow_style=None))
    out.print(f"{counted(len(scene.objects), 'object')} in {file}")


def _read(connect: str, name: str | None) -> Scene:
    with connected(connect, name) as client:
        return client.ask(client.keys.scene, Scene)


def _edit(connect: str, robot: str | None, as_json: bool, **edit: object) -> None:
    request = message(SceneEdit, edit=edit)
    with connected(connect, robot) as client:
        _apply(client, request, as_json)


def _apply(client: Client, edit: SceneEdit, as_json: bool) -> None:
    edited = client.ask(client.keys.scene_edit, SceneEdited, edit)
    if as_json:
        print_json(edited)
    else:
        out.print(f"the scene holds {counted(edited.count, 'object')} (revision {edited.revision})")


def _read_objects(file: Path) -> object:
    try:
        data = yaml.safe_load(read_bytes(file))
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        place = f"{file}:{mark.line + 1}" if mark else str(file)
        reason = " ".join(str(getattr(error, "problem", None) or error).split())
        raise InvalidRequest(f"{place}: not valid YAML: {reason}") from error
    if not isinstance(data, dict) or set(data) != {"objects"}:
        raise InvalidRequest(f"{file}: a scene is a mapping with the one key `objects`, a list")
    return data["objects"]
