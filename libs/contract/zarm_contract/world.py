"""Worlds for simulations with physics: a YAML file, by name if it comes with zarm."""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pydantic import Field

from zarm_contract.codec import decode
from zarm_contract.document import Document, KeyPath
from zarm_contract.errors import InvalidRequest, ZarmError, from_problem
from zarm_contract.messages import (
    Conveyor,
    DynamicObject,
    LoadScene,
    LoadWorld,
    MovingObjects,
    NonNegative,
    Positive,
    Texture,
    Vector3,
)
from zarm_contract.messages.physics import PNG
from zarm_contract.section import Section, read_section

WORLDS = Path(__file__).parent / "worlds"


class Dynamic(Section):
    """An object that moves when it is pushed."""

    mass: Positive
    """kg, spread evenly."""
    friction: NonNegative = 1.0
    """Coefficient of its sliding friction; of two that touch the larger one counts."""


class Belt(Section):
    """A fixed object that takes along what lies on it."""

    speed: float
    """How fast its surface runs along its own x axis (m/s)."""


class Moving(Section):
    """Objects that move together, whatever is in their way."""

    objects: list[str] = Field(min_length=1)
    """Their names."""
    path: list[Vector3] = Field(min_length=2)
    """Displacements from where they are described (m), in the frame of `base_link`."""
    speed: Positive
    """m/s."""
    once: bool = False
    """Stay at the end of the path. Otherwise they come back and go again."""


class WorldFile(Section):
    """A world: its `objects` are written as those of a scene, so that a saved scene is a world."""

    description: str = ""
    """What it is, in a sentence."""
    floor: float | None = None
    """Height of a floor without end (m), in the frame of `base_link`. Left out: there is none."""
    objects: list[dict[str, Any]] = Field(default=[], max_length=1000)
    """The objects, in the frame of `base_link`; fixed unless they are in one of the following."""
    dynamic: dict[str, Dynamic] = Field(default={})
    """Objects that move when they are pushed, by name."""
    conveyors: dict[str, Belt] = Field(default={})
    """Objects whose surface runs, by name."""
    moving: list[Moving] = Field(default=[])
    """Objects that move by themselves."""
    textures: dict[str, str] = Field(default={})
    """What cuboids look like to cameras, by name: the PNG file, beside this one, of a picture on their +z face, with the first row towards +y."""


def find_world(name_or_path: str) -> Path:
    """The file of a world that comes with zarm, or of a path. Raises InvalidRequest."""
    if name_or_path.endswith((".yaml", ".yml")) or "/" in name_or_path:
        path = Path(name_or_path)
        if not path.is_file():
            raise InvalidRequest(f"there is no world at {path}")
        return path
    path = WORLDS / f"{name_or_path}.yaml"
    if not path.is_file():
        known = ", ".join(sorted(file.stem for file in WORLDS.glob("*.yaml")))
        raise InvalidRequest(f"unknown world {name_or_path!r}: zarm brings {known}; or give the path of a .yaml file")
    return path


def read_world_file(path: Path) -> tuple[Document, WorldFile]:
    """A world as it is written. Raises InvalidRequest with file and line."""
    return read_section(path, "a world", WorldFile)


def load_world(name_or_path: str) -> LoadWorld:
    """Read and check a world. Raises InvalidRequest with file and line."""
    document, file = read_world_file(find_world(name_or_path))
    try:
        objects = decode(LoadScene, json.dumps({"op": "load", "objects": file.objects}).encode()).objects
    except ZarmError as error:
        place = document.place(error.problem.field or "objects")
        message = f"{place}: {error.problem.message}"
        raise from_problem(error.problem.model_copy(update={"message": message})) from error
    world = LoadWorld(
        objects=objects,
        floor=file.floor,
        dynamic=tuple(
            DynamicObject(name=name, mass=one.mass, friction=one.friction) for name, one in file.dynamic.items()
        ),
        conveyors=tuple(Conveyor(name=name, speed=one.speed) for name, one in file.conveyors.items()),
        moving=tuple(
            MovingObjects(names=tuple(one.objects), path=tuple(one.path), speed=one.speed, once=one.once)
            for one in file.moving
        ),
        textures=tuple(
            Texture(name=name, image=_read_picture(document, name, path)) for name, path in file.textures.items()
        ),
    )
    names = {"dynamic": list(file.dynamic), "conveyors": list(file.conveyors), "textures": list(file.textures)}
    for field, message in world_faults(world):
        head = str(field[0])
        key = (head, names[head][int(field[1])]) if head in names else field
        raise InvalidRequest(document.fault(key, message))
    return world


def _read_picture(document: Document, name: str, file: str) -> str:
    path = document.path.parent / file
    try:
        picture = path.read_bytes()
    except OSError as error:
        raise InvalidRequest(document.fault(("textures", name), f"{path}: {error.strerror}")) from error
    if not picture.startswith(PNG):
        raise InvalidRequest(document.fault(("textures", name), f"{path} is not a PNG file"))
    return b64encode(picture).decode()


def world_faults(world: LoadWorld) -> Iterator[tuple[KeyPath, str]]:
    """What of a world does not fit together, with the field of each fault."""
    kinds = {item.name: item.kind for item in world.objects}
    named = [
        *((("dynamic", k), one.name) for k, one in enumerate(world.dynamic)),
        *((("conveyors", k), one.name) for k, one in enumerate(world.conveyors)),
        *((("moving", k, "names"), name) for k, one in enumerate(world.moving) for name in one.names),
    ]
    seen: set[str] = set()
    for field, name in named:
        if name not in kinds:
            yield field, f"no object is named {name}; there are {', '.join(kinds) or 'none'}"
        elif kinds[name] == "mesh":
            yield field, f"{name} is a mesh, which has no body; describe it by a primitive or voxels"
        elif name in seen:
            yield field, f"{name} is named twice; an object is dynamic, a conveyor or moving"
        seen.add(name)
    for k, texture in enumerate(world.textures):
        if kinds.get(texture.name) != "cuboid":
            cuboids = [name for name, kind in kinds.items() if kind == "cuboid"]
            yield ("textures", k), f"no cuboid is named {texture.name}; there are {', '.join(cuboids) or 'none'}"
    if len(kinds) < len(world.objects):
        yield ("objects",), "two objects have the same name"
