"""What stands around the robot, and what of it moves."""

from __future__ import annotations

from base64 import b64decode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

import mujoco
import numpy as np

from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import DynamicObject, LoadWorld, MovingObjects, SceneObject
from zarm_contract.world import world_faults
from zarm_physics_sim.shapes import object_geoms, pose_of
from zarm_trajectory.arrays import Array

_OBJECT = "object/"


@dataclass(frozen=True)
class Walk:
    """How `names` move: along a `path` (n, 3) of displacements (m) at a `speed` (m/s), and back, or `once`."""

    names: tuple[str, ...]
    path: Array
    speed: float
    once: bool

    @classmethod
    def of(cls, moving: MovingObjects) -> Self:
        """As the message says it."""
        return cls(moving.names, np.array(moving.path), moving.speed, moving.once)

    def at(self, time: float) -> Array:
        """The displacement (3,) after `time` s."""
        way = np.insert(np.cumsum(np.linalg.norm(np.diff(self.path, axis=0), axis=1)), 0, 0.0)
        gone = self.speed * time
        if not self.once and way[-1] > 0.0:
            gone = way[-1] - abs(gone % (2.0 * way[-1]) - way[-1])
        return np.array([np.interp(gone, way, column) for column in self.path.T])


@dataclass(frozen=True)
class World:
    """Objects by name, and the height of a `floor` (m). Some are `dynamic`, others `belts` with the speed of their surface (m/s), or
    go on `walks`; the rest is fixed. Cameras see `textures`, PNG files. It is `believed` if it is what the scene says, nothing else being known.
    """

    objects: Mapping[str, SceneObject] = field(default_factory=dict)
    floor: float | None = None
    dynamic: Mapping[str, DynamicObject] = field(default_factory=dict)
    belts: Mapping[str, float] = field(default_factory=dict)
    walks: Sequence[Walk] = ()
    textures: Mapping[str, bytes] = field(default_factory=dict)
    believed: bool = False

    @classmethod
    def of(cls, message: LoadWorld) -> Self:
        """The world of a message. Raises InvalidRequest."""
        for key, fault in world_faults(message):
            raise InvalidRequest(fault, field=".".join(map(str, key)))
        return cls(
            {item.name: item.model_copy() for item in message.objects},  # things of their own, even if they are alike
            message.floor,
            {one.name: one for one in message.dynamic},
            {one.name: one.speed for one in message.conveyors},
            tuple(map(Walk.of, message.moving)),
            {one.name: b64decode(one.image) for one in message.textures},
        )

    @property
    def stated(self) -> bool:
        """Whether there is anything in it; else the scene says what there is."""
        return bool(self.objects) or self.floor is not None

    def joined(self, other: Self) -> Self:
        """This world with the objects of another one beside its own. Raises InvalidRequest for names that are in both."""
        if known := [name for name in other.objects if name in self.objects]:
            raise InvalidRequest(f"{', '.join(known)}: in the world already; choose another name", field="objects")
        return replace(
            self,
            objects={**self.objects, **other.objects},
            floor=self.floor if other.floor is None else other.floor,
            dynamic={**self.dynamic, **other.dynamic},
            belts={**self.belts, **other.belts},
            walks=(*self.walks, *other.walks) if other.walks else self.walks,
            textures={**self.textures, **other.textures},
        )

    def of_scene(self, objects: Sequence[SceneObject]) -> Self:
        """This world, or if it is empty one of these objects, all fixed."""
        return self if self.stated else replace(self, objects={item.name: item for item in objects}, believed=True)

    def add_to(self, spec: mujoco.MjSpec) -> None:
        """Add all of it to a model."""
        if self.floor is not None:
            spec.worldbody.add_geom(
                name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.0, 0.0, 1.0], pos=[0.0, 0.0, self.floor]
            )
        walking = {name for walk in self.walks for name in walk.names}
        for name, item in self.objects.items():
            body = add_object(spec.worldbody, item, self.dynamic.get(name))
            body.mocap = name in walking
            for geom in body.geoms if name in self.belts else ():
                geom.surfacevel = [self.belts[name], 0.0, 0.0, 0.0, 0.0, 0.0]
            for geom in body.geoms if name in self.textures else ():
                geom.material = _add_material(spec, body.name, self.textures[name])


def _add_material(spec: mujoco.MjSpec, name: str, picture: bytes) -> str:
    """Add a material that looks like a picture; returns its name."""
    file = f"{name}.png"
    spec.assets = {**spec.assets, file: picture}
    spec.add_texture(name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, file=file)
    material = spec.add_material(name=name)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
    return name


def body_name(item: str) -> str:
    """The name of an object's body and joint: a link may have the name of an object."""
    return _OBJECT + item


def is_object(body: str) -> bool:
    """Whether a body or joint is that of an object."""
    return body.startswith(_OBJECT)


def object_name(body: str) -> str:
    """The name of the object or link whose body it is."""
    return body.removeprefix(_OBJECT)


def add_object(
    parent: Any, item: SceneObject, dynamic: DynamicObject | None, density: float = 0.0, mass: float | None = None
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
