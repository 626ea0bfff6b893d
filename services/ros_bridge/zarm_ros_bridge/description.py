"""The URDF for ROS: the robot's own, with a shape added to each link without one, and the frames of its tools."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterator

from zarm_contract.collision import (
    CollisionCapsule,
    CollisionCuboid,
    CollisionCylinder,
    CollisionPrimitive,
    CollisionSphere,
)
from zarm_contract.messages import Vector3
from zarm_contract.robot import RobotDescription
from zarm_contract.rpy import rpy_of


def shown_description(robot: RobotDescription) -> str:
    """The robot's URDF, with a link for the tip of each tool; a link without a `<visual>` gets its exact collision geometry from the descriptor."""
    tree = ET.fromstring(robot.urdf_path.read_text())  # noqa: S314  the file that the robot was loaded from
    for link in tree.iter("link"):
        if link.find("visual") is None:
            for primitive in robot.descriptor.collision.get(link.get("name", ""), ()):
                for position, rpy, shape in _shapes(primitive):
                    visual = ET.SubElement(link, "visual")
                    ET.SubElement(visual, "origin", xyz=_numbers(position), rpy=_numbers(rpy))
                    ET.SubElement(visual, "geometry").append(shape)
    for name in robot.descriptor.tools:
        joint = robot.urdf.joint_of_child[name]
        ET.SubElement(tree, "link", name=name)
        fixed = ET.SubElement(tree, "joint", name=joint.name, type="fixed")
        ET.SubElement(fixed, "origin", xyz=_numbers(joint.xyz), rpy=_numbers(joint.rpy))
        ET.SubElement(fixed, "parent", link=joint.parent)
        ET.SubElement(fixed, "child", link=name)
    ET.indent(tree)
    return ET.tostring(tree, encoding="unicode")


def _shapes(primitive: CollisionPrimitive) -> Iterator[tuple[Vector3, Vector3, ET.Element]]:
    """Position (m), roll, pitch and yaw (rad), and the element; a capsule becomes three, since URDF has none."""
    match primitive:
        case CollisionSphere():
            yield primitive.center, (0.0, 0.0, 0.0), _sphere(primitive.radius)
        case CollisionCuboid():
            yield primitive.center, rpy_of(primitive.orientation), ET.Element("box", size=_numbers(primitive.size))
        case CollisionCylinder() | CollisionCapsule():
            a, b = primitive.a, primitive.b
            x, y, z = (end - start for start, end in zip(a, b, strict=True))
            middle = ((a[0] + b[0]) / 2, (a[1] + b[1]) / 2, (a[2] + b[2]) / 2)
            turn = (0.0, math.atan2(math.hypot(x, y), z), math.atan2(y, x))  # rotates z to the axis
            length = math.hypot(x, y, z)
            yield middle, turn, ET.Element("cylinder", radius=repr(primitive.radius), length=repr(length))
            if isinstance(primitive, CollisionCapsule):
                for end in (a, b):
                    yield end, (0.0, 0.0, 0.0), _sphere(primitive.radius)


def _sphere(radius: float) -> ET.Element:
    return ET.Element("sphere", radius=repr(radius))


def _numbers(values: tuple[float, ...]) -> str:
    return " ".join(map(repr, values))
