"""What stands around the robot: a file, or what the scene says."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
from pydantic import Field

from zarm_contract.codec import decode
from zarm_contract.errors import InvalidRequest, ZarmError, from_problem
from zarm_contract.messages import LoadScene, NonNegative, Positive, SceneObject
from zarm_contract.section import Section, read_section
from zarm_physics_sim.shapes import object_geoms, pose_of

_OBJECT = "object/"


class Dynamic(Section):
    """An object that moves when it is pushed."""

    mass: Positive
    """kg, spread evenly."""
    friction: NonNegative = 1.0
    """Coefficient of its sliding friction; of two that touch the larger one counts."""


class WorldFile(Section):
    """A world: its `objects` are written as those of a scene, so that a saved scene is a world."""

    floor: float | None = None
    """Height of a floor without end (m), in the frame of `base_link`. Left out: there is none."""
    objects: list[dict[str, Any]] = Field(default=[], max_length=1000)
    """The objects, in the frame of `base_link`."""
    dynamic: dict[str, Dynamic] = Field(default={})
    """Objects that move, by name; the others are fixed."""


@dataclass(frozen=True)
class World:
    """Objects by name, some of which are `dynamic`, and the height of a floor (m)."""

    objects: Mapping[str, SceneObject]
    dynamic: Mapping[str, Dynamic]
    floor: float | None = None

    def add_to(self, spec: mujoco.MjSpec) -> None:
        """Add all of it to a model."""
        if self.floor is not None:
            spec.worldbody.add_geom(
                name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.0, 0.0, 1.0], pos=[0.0, 0.0, self.floor]
            )
        for name, item in self.objects.items():
            add_object(spec.worldbody, item, self.dynamic.get(name))


def body_name(item: str) -> str:
    """The name of an object's body and joint: a link may have the name of an object."""
    return _OBJECT + item


def object_name(body: str) -> str:
    """The name of the object or link whose body it is."""
    return body.removeprefix(_OBJECT)


def add_object(
    parent: Any, item: SceneObject, dynamic: Dynamic | None, density: float = 0.0, mass: float | None = None
) -> Any:
    """Add an object to a body: free to move if `dynamic`, else fixed to it, with a `mass` (kg) or density (kg/m³). Returns its body."""
    position, orientation = pose_of(item)
    body = parent.add_body(name=body_name(item.name), pos=list(position), quat=orientation)
    geoms = [{"density": density, **shape} for shape in object_geoms(item)]
    if dynamic is not None:
        body.add_freejoint(name=body_name(item.name))
        slide = [dynamic.friction, 0.005, 0.0001]
        geoms = [{**geom, "mass": dynamic.mass / len(geoms), "friction": slide, "condim": 4} for geom in geoms]
    elif mass is not None:
        geoms = [{**geom, "mass": mass / len(geoms)} for geom in geoms]
    for geom in geoms:
        body.add_geom(**geom)
    return body


def read_world(path: Path) -> World:
    """Read a world. Raises InvalidRequest with file and line."""
    document, world = read_section(path, "a world", WorldFile)
    try:
        load = decode(LoadScene, json.dumps({"op": "load", "objects": world.objects}).encode())
    except ZarmError as error:
        place = document.place(error.problem.field or "objects")
        message = f"{place}: {error.problem.message}"
        raise from_problem(error.problem.model_copy(update={"message": message})) from error
    objects = {item.name: item for item in load.objects}
    for name in world.dynamic:
        if name not in objects:
            raise InvalidRequest(
                document.fault(("dynamic", name), f"no object is named {name}; there are {', '.join(objects)}")
            )
        if objects[name].kind == "mesh":
            raise InvalidRequest(
                document.fault(("dynamic", name), "meshes do not move; describe it by a primitive or voxels")
            )
    return World(objects, world.dynamic, world.floor)
