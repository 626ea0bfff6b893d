"""What a URDF may hold, and what each element and attribute means to zarm. Nothing else is passed over in silence."""

from __future__ import annotations

import difflib
import unicodedata
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass, field

from zarm_contract.urdf_document import UrdfDocument


@dataclass(frozen=True)
class Element:
    """An element that is taken: its attributes, the child elements of which it has one at most, and those that it may have
    many of.

    An attribute or element that is not known is refused, because it could be meant to change the robot: a limit, an
    origin, a shape. Where the element is `open`, as exporters add much of their own there, it is refused only if it looks
    like a misspelled one, and is noted otherwise. `shapes` are child elements of which one excludes the others.
    """

    attributes: tuple[str, ...] = ()
    once: tuple[str, ...] = ()
    many: tuple[str, ...] = ()
    shapes: tuple[str, ...] = ()
    open: bool = False

    @property
    def children(self) -> tuple[str, ...]:
        """All child elements that are taken."""
        return self.once + self.many + self.shapes


TAKEN = {
    "robot": Element(("name", "version"), many=("link", "joint"), open=True),
    "link": Element(("name",), once=("inertial",), many=("visual", "collision"), open=True),
    "inertial": Element(once=("origin", "mass", "inertia")),
    "mass": Element(("value",)),
    "inertia": Element(("ixx", "ixy", "ixz", "iyy", "iyz", "izz")),
    "visual": Element(("name",), once=("origin", "geometry")),
    "collision": Element(("name",), once=("origin", "geometry")),
    "geometry": Element(shapes=("mesh", "box", "cylinder", "sphere", "capsule")),
    "mesh": Element(("filename", "scale")),
    "box": Element(("size",)),
    "cylinder": Element(("radius", "length")),
    "capsule": Element(("radius", "length")),
    "sphere": Element(("radius",)),
    "joint": Element(
        ("name", "type"), once=("origin", "parent", "child", "axis", "limit", "mimic", "safety_controller")
    ),
    "origin": Element(("xyz", "rpy", "quat_xyzw")),
    "parent": Element(("link",)),
    "child": Element(("link",)),
    "axis": Element(("xyz",)),
    "limit": Element(("lower", "upper", "velocity", "effort", "acceleration", "deceleration", "jerk")),
    "mimic": Element(("joint", "multiplier", "offset")),
    "safety_controller": Element(("soft_lower_limit", "soft_upper_limit", "k_position", "k_velocity")),
}
"""URDF 1.0 as in http://wiki.ros.org/urdf/XML and the schema of urdfdom, with what 1.1 and 1.2 add."""

SINCE = {
    "quat_xyzw": (1, 1),
    "capsule": (1, 2),
    "acceleration": (1, 2),
    "deceleration": (1, 2),
    "jerk": (1, 2),
}
"""The version of URDF that brought an element or attribute, if that is not 1.0."""

WITHOUT_MEANING = {
    "robot": {
        "transmission": "gears between motors and joints: the limits are those of the joints",
        "gazebo": "for a simulator",
        "mujoco": "for a simulator",
        "ros2_control": "the driver on ROS; the import reads the trajectory controller that it names",
        "sensor": "what a sensor measures; its geometry is that of its link",
        "light": "for a simulator",
        "material": "looks",
        "verbose": "for a parser",
    },
    "link": {
        "type": "of the PR2: laser or camera",
        "contact": "friction and stiffness, for simulators",
        "surface": "friction and stiffness, for simulators",
        "gravity": "for a simulator",
        "kinematic": "for a simulator",
        "self_collide": "for a simulator",
        "self_filter": "what a sensor filter takes out of its image",
        "material": "looks",
    },
    "visual": {"material": "looks", "cast_shadows": "looks", "transparency": "looks"},
    "collision": {
        "material": "looks",
        "verbose": "for a parser",
        "surface": "friction and stiffness, for simulators",
        "contact_coefficients": "friction and stiffness, for simulators",
        "max_contacts": "for a simulator",
        "group": "of old files: a name",
    },
    "geometry": {"name": "a name"},
    "joint": {
        "calibration": "where the joint's reference switch is, for its driver",
        "dynamics": "friction and damping: not part of the kinematics, nor of the limits",
        "dont_collapse": "for a converter",
        "hardwareInterface": "for the driver",
    },
    "limit": {
        "current": "the motor's, behind the limits of the joint",
        "gear_velocity": "the motor's, behind the limits of the joint",
        "command_effort": "the controller's; zarm plans no efforts",
    },
}
"""By the element that holds it, and with the reason: what changes no motion, neither kinematics nor limits nor geometry."""

_PREFIXES = ("xmlns", "xml", "xsi")
"""Attributes of XML itself, anywhere."""
_VERSIONS = ((1, 0), (1, 1), (1, 2))
_ALIKE = 0.8
"""A name that is so similar to a known one (difflib's ratio) is taken as misspelled."""


@dataclass
class Account:
    """What is in a file beside what is taken: `faults`, which could change the robot, and `notes`, each as `file:line: what`."""

    faults: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def account_for(document: UrdfDocument) -> Account:
    """Go over every element, attribute and text of a URDF."""
    account = Account()
    version = _version(document.root.get("version"))
    if version not in _VERSIONS:
        account.notes.append(
            f"{document.place(document.root)}: the file says version={document.root.get('version')!r} of URDF; known are 1.0, 1.1 and 1.2, "
            "as which it is read"
        )
    often: dict[str, list[ET.Element]] = {}
    for element, message, refused in _findings(document.root, version):
        if refused:
            account.faults.append(f"{document.place(element)}: {message}")
        else:
            often.setdefault(message, []).append(element)
    for message, elements in often.items():
        more = f" (and {len(elements) - 1} more times)" if len(elements) > 1 else ""
        account.notes.append(f"{document.place(elements[0])}: {message}{more}")
    account.notes += _lookalikes(document)
    return account


Finding = tuple[ET.Element, str, bool]


def _findings(root: ET.Element, version: tuple[int, int] | None) -> Iterator[Finding]:
    """Each with its element, and whether it is refused."""
    waiting = [root]
    while waiting:
        element = waiting.pop()
        known = TAKEN[element.tag]
        yield from _attributes(element, known, version)
        yield from _texts(element, known)
        taken: list[ET.Element] = []
        for child in element:
            if child.tag in known.children:
                taken.append(child)
                if (since := SINCE.get(child.tag)) and version in _VERSIONS and version < since:
                    yield child, _newer(f"<{child.tag}>", since), False
            else:
                yield from _unknown(element, child, known)
        yield from _repeated(element, known, taken)
        waiting += reversed(taken)


def _attributes(element: ET.Element, known: Element, version: tuple[int, int] | None) -> Iterator[Finding]:
    for name in element.attrib:
        if name in known.attributes:
            if (since := SINCE.get(name)) and version in _VERSIONS and version < since:
                yield element, _newer(f"{name}= in <{element.tag}>", since), False
            continue
        if name in WITHOUT_MEANING.get(element.tag, ()) or name.partition(":")[0] in _PREFIXES:
            continue
        what = f"<{element.tag}> has {name}=, which no URDF knows"
        meant = None if ":" in name else _misspelled(name, known.attributes)
        if meant:
            yield element, f"{what}; did you mean {meant}=?", True
        elif ":" in name or (known.children and name not in _ATTRIBUTES):
            yield element, f"{what}; it has no effect", False
        else:
            takes = f"it takes {', '.join(known.attributes)}" if known.attributes else "it takes none"
            yield element, f"{what} there; {takes}: correct it, or take it out", True


def _texts(element: ET.Element, known: Element) -> Iterator[Finding]:
    texts = [element.text, *(child.tail for child in element)]
    for text in texts:
        if text and (shown := " ".join(text.split())):
            shown = shown if len(shown) <= 40 else f"{shown[:37]}..."
            if known.children:
                yield element, f"<{element.tag}> holds the text {shown!r}, which has no effect", False
            else:
                takes = f"{known.attributes[0]}="
                yield (
                    element,
                    f"<{element.tag}> holds the text {shown!r}; a URDF has values in attributes: write {takes}",
                    True,
                )


def _unknown(parent: ET.Element, child: ET.Element, known: Element) -> Iterator[Finding]:
    if child.tag in WITHOUT_MEANING.get(parent.tag, ()):
        return
    local = child.tag.rpartition(":")[2]
    what = f"<{parent.tag}> holds <{child.tag}>"
    if local == "include":
        yield child, f"{what}, which no reader of URDFs follows; write the content of that file here", True
    elif child.tag == "origin" and parent.tag == "link" and _is_identity(child):
        yield child, f"{what}, which is no part of a link; it has no effect", False
    elif child.tag in TAKEN:
        where = ", ".join(f"<{name}>" for name, one in TAKEN.items() if child.tag in one.children) or "the root"
        yield child, f"{what}, which belongs into {where}: move it there, or take it out", True
    elif meant := _misspelled(child.tag, known.children):
        yield child, f"{what}, which no URDF knows; did you mean <{meant}>?", True
    elif local in TAKEN or not known.open:
        yield (
            child,
            f"{what}, which no URDF knows and zarm does not read; take it out, or write it as a URDF has it",
            True,
        )
    else:
        yield child, f"{what}, which no URDF knows; it has no effect", False


def _repeated(element: ET.Element, known: Element, taken: list[ET.Element]) -> Iterator[Finding]:
    shapes = [child for child in taken if child.tag in known.shapes]
    if len(shapes) > 1:
        yield (
            shapes[1],
            f"<{element.tag}> holds {len(shapes)} shapes, <{shapes[0].tag}> and <{shapes[1].tag}>, where a URDF has one; give each a "
            "<collision> or <visual> of its own",
            True,
        )
    for tag in known.once:
        if len(same := [child for child in taken if child.tag == tag]) > 1:
            yield same[1], f"<{element.tag}> has {len(same)} <{tag}>; keep one", True


def _misspelled(name: str, known: tuple[str, ...]) -> str | None:
    """The known name that this one stands for: similar, with its letters in another order, or in capitals."""
    plain = name.lower().replace("-", "_")
    if plain in known:
        return plain
    scrambled = next((one for one in known if sorted(one) == sorted(plain)), None)
    return scrambled or next(iter(difflib.get_close_matches(plain, known, 1, _ALIKE)), None)


_ATTRIBUTES = {name for element in TAKEN.values() for name in element.attributes} - {"name", "type", "value", "version"}
"""Attributes with a meaning somewhere, which are at a wrong place elsewhere."""


def _is_identity(origin: ET.Element) -> bool:
    try:
        values = [float(part) for text in origin.attrib.values() for part in text.split()]
    except ValueError:
        return False
    return not any(values) and "quat_xyzw" not in origin.attrib


def _newer(what: str, since: tuple[int, int]) -> str:
    return f'{what} is of URDF {since[0]}.{since[1]}, and the file says less; it is taken: write version="{since[0]}.{since[1]}"'


def _version(text: str | None) -> tuple[int, int] | None:
    major, _, minor = (text or "1.0").strip().partition(".")
    try:
        return int(major), int(minor or "0")
    except ValueError:
        return None


def _lookalikes(document: UrdfDocument) -> Iterator[str]:
    """Names that differ, but look alike: the same letters, composed in another way."""
    for tag in ("link", "joint"):
        seen: dict[str, str] = {}
        for element in document.root.findall(tag):
            name = element.get("name", "")
            other = seen.setdefault(unicodedata.normalize("NFC", name), name)
            if other != name:
                yield (
                    f"{document.place(element)}: the names of two {tag}s look alike, {name!r}, but are written with other characters; "
                    "rename one"
                )
