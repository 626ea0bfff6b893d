"""Edits of the scene that mount tools on the robot and take them off."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

import numpy as np

from zarm_contract.collision import CollisionCuboid, CollisionCylinder, CollisionPrimitive, CollisionSphere
from zarm_contract.errors import InvalidRequest, Unavailable
from zarm_contract.messages import (
    MAX_ATTACHED,
    Attached,
    AttachObject,
    Capsule,
    Cuboid,
    Cylinder,
    Primitive,
    Scene,
    Sphere,
)
from zarm_contract.robot import RobotDescription
from zarm_contract.tool import Tool
from zarm_geometry.frames import matrix, pose_of, rotation_to


@dataclass(frozen=True)
class Tools:
    """The tools of a robot with this `tip_link`: the shapes of each as they are attached, all to one link. `path` is the descriptor's."""

    robot: str = "the robot"
    tip_link: str = ""
    path: Path = Path()
    shapes: Mapping[str, tuple[Attached, ...]] = field(default_factory=dict)

    @classmethod
    def of(cls, robot: RobotDescription) -> Self:
        """Those that a descriptor describes."""
        descriptor = robot.descriptor
        shapes = {
            name: _shapes(name, tool, tool.link or descriptor.tip_link) for name, tool in descriptor.tools.items()
        }
        return cls(descriptor.name, descriptor.tip_link, robot.path, shapes)

    def mount(self, scene: Scene, name: str) -> Scene:
        """The scene with a tool mounted, in place of one on the same link. Raises InvalidRequest."""
        if name not in self.shapes:
            has = f"it has {', '.join(self.shapes)}" if self.shapes else "describe it in `tools` of its descriptor"
            raise InvalidRequest(f"{self.robot} has no tool {name}; {has}", field="edit.tool")
        if name in scene.tools:
            raise InvalidRequest(f"{name} is mounted already", field="edit.tool")
        for other in scene.tools:
            if self.shapes[other][0].link == self.shapes[name][0].link:
                scene = unmount(scene, other)
        taken = {item.name for item in scene.objects} | {one.object.name for one in scene.attached}
        for shape in self.shapes[name]:
            if shape.object.name in taken:
                raise InvalidRequest(
                    f"{shape.object.name} is the name of an object, and {name} has a shape of this name; add the object under another",
                    field="edit.tool",
                )
        # What hangs on the tip goes on hanging on the link that was the tip.
        hanging = [one if one.link else one.model_copy(update={"link": self.tip_link}) for one in scene.attached]
        attached = (*hanging, *self.shapes[name])
        if len(attached) > MAX_ATTACHED:
            raise InvalidRequest(
                f"the robot would carry {len(attached)} objects and shapes of tools, more than {MAX_ATTACHED}; detach some first",
                field="edit.tool",
            )
        return scene.model_copy(update={"attached": attached})

    def renewed(self, scene: Scene) -> Scene:
        """A saved scene with the mounted tools as the descriptor describes them now. Raises Unavailable for one that it lacks."""
        for name in scene.tools:
            if name not in self.shapes:
                raise Unavailable(
                    f"the saved scene has the tool {name} mounted, and {self.path} does not describe it; describe it there, and unmount "
                    "it before you take it out"
                )
        mounted = [shape for name in scene.tools for shape in self.shapes[name]]
        if mounted == [one for one in scene.attached if one.tool is not None]:
            return scene
        others = [one for one in scene.attached if one.tool is None]
        return scene.model_copy(update={"attached": (*others, *mounted)})


def unmount(scene: Scene, name: str) -> Scene:
    """The scene without a mounted tool. Raises InvalidRequest if it is not there, or carries something."""
    if name not in scene.tools:
        mounted = f"mounted: {', '.join(scene.tools)}" if scene.tools else "none is"
        raise InvalidRequest(f"the tool {name} is not mounted; {mounted}", field="edit.tool")
    for one in scene.attached:
        if one.link == name:
            raise InvalidRequest(f"{name} carries {one.object.name}; detach it first", field="edit.tool")
    return scene.model_copy(update={"attached": tuple(one for one in scene.attached if one.tool != name)})


def at_tool(robot: RobotDescription, scene: Scene, edit: AttachObject) -> AttachObject:
    """An edit that attaches to the tip by default: to that of a mounted tool."""
    tip_link = robot.with_tools(scene.tools).descriptor.tip_link
    if edit.link is not None or tip_link == robot.descriptor.tip_link:
        return edit
    return edit.model_copy(update={"link": tip_link})


def refuse_shapes(scene: Scene, names: Iterable[str], field: str) -> None:
    """Raises InvalidRequest for the shape of a tool: a tool is mounted and taken off as a whole."""
    of = {one.object.name: one.tool for one in scene.attached if one.tool is not None}
    for index, name in enumerate(names):
        if name in of:
            raise InvalidRequest(
                f"{name} is a shape of the tool {of[name]}, which is mounted and unmounted as a whole",
                field=field.format(index),
            )


def _shapes(name: str, tool: Tool, link: str) -> tuple[Attached, ...]:
    """A tool as shapes attached to a link; the first has all of its mass."""
    shapes = [_shape(f"{name}_{number}", primitive) for number, primitive in enumerate(tool.collision, 1)]
    attached = [Attached(object=shape, touch_links=tool.touch_links, link=link, tool=name) for shape in shapes]
    if tool.payload is not None:
        first = shapes[0]
        turn = (0.0, 0.0, 0.0, 1.0) if isinstance(first, Sphere) else first.orientation
        x, y, z, _ = (np.linalg.inv(matrix(first.position, turn)) @ (*tool.payload.center, 1.0)).tolist()
        attached[0] = attached[0].model_copy(update={"mass": tool.payload.mass, "center": (x, y, z)})
    return tuple(attached)


def _shape(name: str, primitive: CollisionPrimitive) -> Primitive:
    """A primitive of the descriptor as an object in the frame of its link."""
    if isinstance(primitive, CollisionSphere):
        return Sphere(kind="sphere", name=name, position=primitive.center, radius=primitive.radius)
    if isinstance(primitive, CollisionCuboid):
        return Cuboid(
            kind="cuboid",
            name=name,
            position=primitive.center,
            orientation=primitive.orientation,
            size=primitive.size,
        )
    a, b = np.array(primitive.a), np.array(primitive.b)
    length = float(np.linalg.norm(b - a))
    if length == 0.0:
        return Sphere(kind="sphere", name=name, position=primitive.a, radius=primitive.radius)
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = rotation_to(b - a), (a + b) / 2
    placed = pose_of(frame).model_dump() | {"name": name, "radius": primitive.radius, "length": length}
    if isinstance(primitive, CollisionCylinder):
        return Cylinder(kind="cylinder", **placed)
    return Capsule(kind="capsule", **placed)
