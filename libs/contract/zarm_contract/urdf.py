"""The kinematics of a URDF: its links and joints, and the transforms between them.

Only what motion needs is read: joint type, parent, child, origin, axis, limits, and the joints that mimic others are
refused. Geometry comes from the robot descriptor.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal
from xml.parsers import expat

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
        """The joints from `base` to `tip`, fixed ones included. Raises InvalidRequest if there is no such chain."""
        joints: list[Joint] = []
        link = tip
        while link != base:
            joint = self.joint_of_child.get(link)
            if joint is None or joint in joints:
                raise InvalidRequest(f"the URDF has no chain of joints from {base} to {tip}; it ends at {link}")
            joints.append(joint)
            link = joint.parent
        return tuple(reversed(joints))


def load_urdf(path: Path) -> Urdf:
    """Read a URDF file. Raises InvalidRequest with file, line and remedy; one line per fault."""
    source = _Source(path)
    links = tuple(source.attribute(link, "name") for link in source.root.findall("link"))
    joints: dict[str, Joint] = {}
    faults: list[str] = []
    for element in source.root.findall("joint"):
        try:
            joint = source.joint(element)
        except InvalidRequest as error:
            faults.append(error.problem.message)
            continue
        faults += [source.place(element) + fault for fault in _misplaced(joint, links, joints)]
        joints[joint.child] = joint
    if faults:
        raise InvalidRequest("\n".join(faults))
    return Urdf(links, joints)


def _misplaced(joint: Joint, links: tuple[str, ...], joints: dict[str, Joint]) -> Iterator[str]:
    """What keeps a joint from joining the tree of those before it."""
    for link in (joint.parent, joint.child):
        if link not in links:
            yield f"joint {joint.name} names the link {link}, which is not in the file; add <link name={link!r}/>"
    if any(joint.name == other.name for other in joints.values()):
        yield f"two joints are named {joint.name}; rename one"
    if joint.child in joints:
        yield f"the link {joint.child} has two parent joints, {joints[joint.child].name} and {joint.name}; keep one"


class _Source:
    """A URDF's elements, and the line of each."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lines: dict[ET.Element, int] = {}
        builder = ET.TreeBuilder()
        parser = expat.ParserCreate()

        def start(tag: str, attributes: dict[str, str]) -> None:
            self._lines[builder.start(tag, attributes)] = parser.CurrentLineNumber

        parser.StartElementHandler = start
        parser.EndElementHandler = builder.end
        try:
            parser.Parse(path.read_bytes(), True)
        except OSError as error:
            raise InvalidRequest(f"cannot read the URDF {path}: {error.strerror or error}") from error
        except expat.ExpatError as error:
            problem = expat.ErrorString(error.code)
            raise InvalidRequest(f"{path}:{error.lineno}: not well-formed XML: {problem}") from error
        self.root = builder.close()
        if self.root.tag != "robot":
            raise self._fault(self.root, f"a URDF starts with <robot>; this file starts with <{self.root.tag}>")

    def place(self, element: ET.Element) -> str:
        return f"{self._path}:{self._lines[element]}: "

    def joint(self, element: ET.Element) -> Joint:
        name = self.attribute(element, "name")
        kind = _TYPES.get(self.attribute(element, "type"))
        if kind is None:
            known = ", ".join(_TYPES)
            raise self._fault(element, f"joint {name} has the type {element.get('type')}; known are {known}")
        mimic = element.find("mimic")
        if mimic is not None:
            raise self._fault(mimic, f"joint {name} mimics another; make it fixed at the position it is used in")
        lower = upper = None
        if kind in ("revolute", "prismatic"):
            limit = element.find("limit")
            if limit is None:
                raise self._fault(element, f"joint {name} ({kind}) needs <limit lower= upper=>")
            lower, upper = self._number(limit, "lower", name), self._number(limit, "upper", name)
            if lower > upper:
                raise self._fault(limit, f"joint {name} has its lower limit {lower} above its upper limit {upper}")
            if lower == upper:
                raise self._fault(
                    limit, f"joint {name} cannot move: both limits are {lower}; give a range or make it fixed"
                )
        axis = element.find("axis")
        direction = self._vector(axis, "xyz", (1.0, 0.0, 0.0), name)
        if axis is not None and not any(direction):
            raise self._fault(axis, f"joint {name} has the axis 0 0 0; give it a direction")
        origin = element.find("origin")
        return Joint(
            name=name,
            type=kind,
            parent=self.attribute(self._child(element, "parent", name), "link"),
            child=self.attribute(self._child(element, "child", name), "link"),
            xyz=self._vector(origin, "xyz", (0.0, 0.0, 0.0), name),
            rpy=self._vector(origin, "rpy", (0.0, 0.0, 0.0), name),
            axis=direction,
            lower=lower,
            upper=upper,
        )

    def attribute(self, element: ET.Element, name: str) -> str:
        value = element.get(name)
        if not value:
            raise self._fault(element, f"a <{element.tag}> has no {name}=")
        return value

    def _child(self, element: ET.Element, tag: str, joint: str) -> ET.Element:
        child = element.find(tag)
        if child is None:
            raise self._fault(element, f"joint {joint} has no <{tag}>")
        return child

    def _number(self, element: ET.Element, name: str, joint: str) -> float:
        text = element.get(name, "0")  # the default of the URDF specification
        try:
            return _finite(text)
        except ValueError as error:
            raise self._fault(
                element, f"joint {joint}: {name}={text!r} is not a finite number{_macro(text)}"
            ) from error

    def _vector(
        self, element: ET.Element | None, name: str, default: tuple[float, float, float], joint: str
    ) -> tuple[float, float, float]:
        text = element.get(name) if element is not None else None
        if element is None or text is None:
            return default
        try:
            x, y, z = (_finite(part) for part in text.split())
        except ValueError as error:
            message = f"joint {joint}: {name}={text!r} must be three finite numbers{_macro(text)}"
            raise self._fault(element, message) from error
        return (x, y, z)

    def _fault(self, element: ET.Element, message: str) -> InvalidRequest:
        return InvalidRequest(self.place(element) + message)


def _finite(text: str) -> float:
    if not math.isfinite(value := float(text)):
        raise ValueError(text)
    return value


def _macro(text: str) -> str:
    return "; this is a xacro file: expand it first with `xacro`" if "$" in text else ""
