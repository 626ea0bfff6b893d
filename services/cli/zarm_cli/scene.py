"""`zarm scene`: edits the scene, which the planner avoids."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.table import Table

from zarm.values import IDENTITY, Pose
from zarm_cli.client import SIGNALS, AsJson, Connect, Name, connected, floats, joints, message
from zarm_cli.output import counted, numbers, out, print_json
from zarm_contract.messages import Capsule, Cuboid, Cylinder, Mesh, Message, SceneEdit, SceneEdited, Sphere, Voxels
from zarm_runtime.session import DEFAULT_ENDPOINT

_POSE_PERIOD = 0.05
_KINDS: dict[str, type[Message]] = {
    "cuboid": Cuboid,
    "sphere": Sphere,
    "capsule": Capsule,
    "cylinder": Cylinder,
    "mesh": Mesh,
}

app = typer.Typer(no_args_is_help=True, help="Show and change the obstacles and attached objects.")


@app.command("list")
def show(as_json: AsJson = False, connect: Connect = DEFAULT_ENDPOINT, name: Name = None) -> None:
    """List objects, attached objects, and links whose collisions are ignored."""
    with connected(connect, name) as robot:
        scene = robot.scene.read()
    if as_json:
        print_json(scene)
        return
    table = Table("name", "kind", "position (m)", "orientation (x, y, z, w)", "dimensions (m)", box=None)
    for one in (*scene.objects, *(carried.object for carried in scene.attached)):
        fields = one.model_dump(exclude={"kind", "name", "position", "orientation", "sha256", "data"})
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
        of = f" of the tool {carried.tool}" if carried.tool else ""
        out.print(f"the robot carries {carried.object.name}{of}, placed from {carried.link or 'its tip'}{touches}")
    if scene.ignored_objects:
        out.print(f"objects whose collisions are ignored: {', '.join(scene.ignored_objects)}")
    if scene.ignored_links:
        out.print(f"links whose collisions are ignored: {', '.join(scene.ignored_links)}")
    if scene.ignored_pairs:
        pairs = ", ".join(f"{one} with {other}" for one, other in scene.ignored_pairs)
        out.print(f"pairs whose collisions are ignored: {pairs}")
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
    radius: Annotated[float | None, typer.Option(help="Radius of a sphere, capsule or cylinder (m).")] = None,
    length: Annotated[float | None, typer.Option(help="Length of a capsule or cylinder along its own z (m).")] = None,
    file: Annotated[
        str | None, typer.Option(help="STL or OBJ file of a mesh (m), in a mesh folder of the planner.")
    ] = None,
    scale: Annotated[
        str | None, typer.Option(metavar="S or X,Y,Z", help="Scale of a mesh; 0.001 for files in mm.")
    ] = None,
    replace: Annotated[bool, typer.Option("--replace", help="Replace an object with the same name.")] = False,
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
    for field, definition in _KINDS[kind].model_fields.items():
        if definition.is_required() and field not in thing:
            raise typer.BadParameter(f"a {kind} needs it", param_hint=f"--{field}")
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


@app.command()
def move(
    object_name: Annotated[str, typer.Argument(metavar="NAME")],
    at: Annotated[str, typer.Option(metavar="X,Y,Z[,QX,QY,QZ,QW]", help="Pose of its centre in the base frame (m).")],
    speed: Annotated[
        float,
        typer.Option(help="Bound on how far its velocity deviates from --velocity, in any direction (m/s)."),
    ],
    velocity: Annotated[str | None, typer.Option(metavar="X,Y,Z", help="Its velocity in the base frame (m/s).")] = None,
    seconds: Annotated[
        float,
        typer.Option("--for", min=0.0, help="Publish 20 times a second for this long (s), moving at --velocity."),
    ] = 0.0,
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """Publish the pose of a moving object, without an edit: `zarm scene move box --at 0.5,0,0.2 --speed 0.2`.

    Without a new pose the object is lost after 1 s: goals near it are held until one comes or an edit of the object places it.
    """
    pose = floats(at, "--at", 3, 7)
    along = [0.0, 0.0, 0.0] if velocity is None else floats(velocity, "--velocity", 3)
    with connected(connect, name) as robot:
        begun = time.monotonic()
        passed = 0.0
        while True:
            place = [x + passed * v for x, v in zip(pose[:3], along, strict=True)]
            robot.scene.move(object_name, Pose(place, pose[3:] or IDENTITY), velocity=along, speed=speed)
            if passed + _POSE_PERIOD > seconds:
                break
            SIGNALS.run_interruptibly(lambda: time.sleep(_POSE_PERIOD))
            passed = time.monotonic() - begun
    out.print(f"told where {object_name} is; without a new pose it is lost after 1 s")


At = Annotated[
    str | None,
    typer.Option("--joints", metavar="A,B,C,...", help="Joint positions of the robot (rad; default: measured)."),
]


@app.command()
def attach(
    object_name: Annotated[str, typer.Argument(metavar="NAME")],
    touch: Annotated[
        list[str] | None, typer.Option(metavar="LINK", help="A link that the object may touch; repeatable.")
    ] = None,
    at: At = None,
    link: Annotated[str | None, typer.Option(help="The link that carries it (default: the tip).")] = None,
    mass: Annotated[
        float | None,
        typer.Option(metavar="KG", help="Its mass, which counts in the torques of plans.", show_default=False),
    ] = None,
    center: Annotated[
        str | None,
        typer.Option(metavar="X,Y,Z", help="Its centre of mass in its own frame (m; default: its middle)."),
    ] = None,
    as_json: AsJson = False,
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """Attach an object to the tip: `zarm scene attach box --touch link_5`."""
    where = joints(at, "--joints")
    fields = {"name": object_name, "touch_links": touch or [], "joints": where, "link": link, "mass": mass}
    _edit(connect, name, as_json, op="attach", center=center and floats(center, "--center"), **fields)


@app.command()
def detach(
    object_name: Annotated[str, typer.Argument(metavar="NAME")],
    at: At = None,
    as_json: AsJson = False,
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """Detach an object and leave it where it is now."""
    _edit(connect, name, as_json, op="detach", name=object_name, joints=joints(at, "--joints"))


@app.command()
def links(
    names: Annotated[list[str], typer.Argument(metavar="LINK...")],
    enabled: Annotated[bool, typer.Option("--on/--off", help="Check the collisions of these links, or ignore them.")],
    as_json: AsJson = False,
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """Ignore collisions of links, or check them again: `zarm scene links link_6 --off`."""
    _edit(connect, name, as_json, op="links", names=names, enabled=enabled)


@app.command()
def objects(
    names: Annotated[list[str], typer.Argument(metavar="OBJECT...")],
    enabled: Annotated[bool, typer.Option("--on/--off", help="Check the collisions of these objects, or ignore them.")],
    as_json: AsJson = False,
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """Ignore collisions of objects, or check them again: `zarm scene objects bin --off`."""
    _edit(connect, name, as_json, op="objects", names=names, enabled=enabled)


@app.command()
def load(
    file: Annotated[Path, typer.Argument(help="YAML file, as `zarm scene save` writes it.")],
    as_json: AsJson = False,
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """Replace all objects by those of a file."""
    with connected(connect, name) as robot:
        print_edited(robot.scene.load(file), as_json)


@app.command()
def save(file: Path, connect: Connect = DEFAULT_ENDPOINT, name: Name = None) -> None:
    """Write the objects to a YAML file for `zarm scene load`; attached objects are left out."""
    with connected(connect, name) as robot:
        count = robot.scene.save(file)
    out.print(f"{counted(count, 'object')} in {file}")


def _edit(connect: str, robot_name: str | None, as_json: bool, **edit: object) -> None:
    request = message(SceneEdit, edit=edit)
    with connected(connect, robot_name) as robot:
        print_edited(robot.scene.apply(request), as_json)


def print_edited(edited: SceneEdited, as_json: bool) -> None:
    """Print what an edit has led to."""
    if as_json:
        print_json(edited)
    else:
        out.print(f"the scene holds {counted(edited.count, 'object')} (revision {edited.revision})")
        for note in edited.notes:
            out.print(note)


@app.command()
def pair(
    one: Annotated[str, typer.Argument(metavar="LINK", help="A link, or an attached object.")],
    other: Annotated[str, typer.Argument(metavar="OBJECT", help="An object, or another of the former.")],
    enabled: Annotated[bool, typer.Option("--on/--off", help="Check the collisions of this pair, or ignore them.")],
    as_json: AsJson = False,
    connect: Connect = DEFAULT_ENDPOINT,
    name: Name = None,
) -> None:
    """Ignore collisions of a link with an object, or check them again: `zarm scene pair link_6 bin --off`."""
    _edit(connect, name, as_json, op="pairs", names=[(one, other)], enabled=enabled)
