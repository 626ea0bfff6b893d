"""The kinematics of a URDF: its links and joints, and the transforms between them.

Only what motion needs is read: joint type, parent, child, origin, axis, limits, and the joints that mimic others are
refused. Geometry comes from the robot descriptor.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from zarm_contract.errors import InvalidRequest

JointType = Literal["revolute", "continuous", "prismatic", "fixed"]
_TYPES: dict[str, JointType] = {
    "revolute": "revolute",
    "continuous": "continuous",
    "prismatic": "prismatic",
    "fixed": "fixed",
}


@dataclass(frozen=True)
class Joint:
    """One URDF joint: `child` = `parent` * origin(`xyz` m, `rpy` rad: Rz(y) Ry(p) Rx(r)) * motion about or along `axis`.

    `lower` and `upper` are in rad (m if prismatic); a continuous or fixed joint has none.
    """

    name: str
    type: JointType
    parent: str
    child: str
    xyz: tuple[float, float, float]
    rpy: tuple[float, float, float]
    axis: tuple[float, float, float]
    lower: float | None
    upper: float | None


@dataclass(frozen=True)
class Urdf:
    """A tree of links; `joints` are keyed by the child link they carry."""

    links: tuple[str, ...]
    joint_of_child: dict[str, Joint]

    def chain(self, base: str, tip: str) -> tuple[Joint, ...]:
        """The joints from `base` to `tip`, fixed ones included. Raises InvalidRequest where there is no such chain."""
        joints: list[Joint] = []
        link = tip
        while link != base:
            joint = self.joint_of_child.get(link)
            if joint is None:
                raise InvalidRequest(f"the URDF has no chain of joints from {base} to {tip}; it ends at {link}")
            joints.append(joint)
            link = joint.parent
        return tuple(reversed(joints))


def load_urdf(path: Path) -> Urdf:
    """Read a URDF file. Raises InvalidRequest with the file and what is wrong in it."""
    try:
        root = ET.parse(path).getroot()
    except OSError as error:
        raise InvalidRequest(f"cannot read the URDF {path}: {error.strerror or error}") from error
    except ET.ParseError as error:
        raise InvalidRequest(f"{path}: not well-formed XML: {error}") from error
    links = tuple(_attribute(link, "name", path) for link in root.iter("link") if link in list(root))
    joints: dict[str, Joint] = {}
    for element in root.findall("joint"):
        joint = _joint(element, path)
        for link in (joint.parent, joint.child):
            if link not in links:
                raise InvalidRequest(f"{path}: joint {joint.name} names the link {link}, which is not in the file")
        if joint.child in joints:
            raise InvalidRequest(f"{path}: the link {joint.child} has two parent joints; a tree needs one")
        joints[joint.child] = joint
    return Urdf(links, joints)


def _joint(element: ET.Element, path: Path) -> Joint:
    name = _attribute(element, "name", path)
    kind = _TYPES.get(_attribute(element, "type", path))
    if kind is None:
        raise InvalidRequest(f"{path}: joint {name} has the type {element.get('type')}; known are {', '.join(_TYPES)}")
    if element.find("mimic") is not None:
        raise InvalidRequest(f"{path}: joint {name} mimics another; make it fixed at the position it is used in")
    origin = element.find("origin")
    axis = element.find("axis")
    limit = element.find("limit")
    bounded = kind in ("revolute", "prismatic")
    if bounded and limit is None:
        raise InvalidRequest(f"{path}: joint {name} ({kind}) needs <limit lower= upper=>")
    return Joint(
        name=name,
        type=kind,
        parent=_attribute(_child(element, "parent", path, name), "link", path),
        child=_attribute(_child(element, "child", path, name), "link", path),
        xyz=_vector(origin, "xyz", (0.0, 0.0, 0.0), path, name),
        rpy=_vector(origin, "rpy", (0.0, 0.0, 0.0), path, name),
        axis=_vector(axis, "xyz", (1.0, 0.0, 0.0), path, name),
        lower=_number(limit, "lower", path, name) if bounded else None,
        upper=_number(limit, "upper", path, name) if bounded else None,
    )


def _child(element: ET.Element, tag: str, path: Path, joint: str) -> ET.Element:
    child = element.find(tag)
    if child is None:
        raise InvalidRequest(f"{path}: joint {joint} has no <{tag}>")
    return child


def _attribute(element: ET.Element, name: str, path: Path) -> str:
    value = element.get(name)
    if not value:
        raise InvalidRequest(f"{path}: a <{element.tag}> has no {name}=")
    return value


def _number(element: ET.Element | None, name: str, path: Path, joint: str) -> float:
    text = "0" if element is None else element.get(name, "0")
    try:
        return float(text)
    except ValueError as error:
        raise InvalidRequest(f"{path}: joint {joint}: {name}={text!r} is no number") from error


def _vector(
    element: ET.Element | None, name: str, default: tuple[float, float, float], path: Path, joint: str
) -> tuple[float, float, float]:
    text = element.get(name) if element is not None else None
    if text is None:
        return default
    try:
        x, y, z = (float(part) for part in text.split())
    except ValueError as error:
        raise InvalidRequest(f"{path}: joint {joint}: {name}={text!r} must be three numbers") from error
    return (x, y, z)
