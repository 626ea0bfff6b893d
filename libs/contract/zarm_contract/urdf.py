"""The kinematics of a URDF: its links and joints, and the transforms between them.

`read_joint` and `read_inertial` are the only readers of joints and masses, for descriptors and for the import alike. What else
is in the file is accounted for in `urdf_elements`. Geometry comes from the robot descriptor.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, get_args

from zarm_contract.errors import InvalidRequest
from zarm_contract.urdf_document import UrdfDocument, parse_urdf
from zarm_contract.urdf_elements import account_for

JointType = Literal["revolute", "continuous", "prismatic", "fixed", "floating", "planar"]
_TYPES: dict[str, JointType] = {kind: kind for kind in get_args(JointType)}
_LIMITED = ("revolute", "prismatic")
_DRIVEN = ("revolute", "continuous", "prismatic")
_MIN_AXIS_LENGTH = 1e-9
"""Length of an axis, at least."""


@dataclass(frozen=True)
class Joint:
    """One URDF joint: `child` = `parent` * origin(`xyz` m, `rpy` rad: Rz(y) Ry(p) Rx(r)) * motion about or along `axis`.

    `axis` has length 1. `lower` and `upper` are in rad (m if prismatic), the soft limits where the URDF has them; a continuous
    or fixed joint has none, nor has one without <limit>. `velocity`, `effort`, `acceleration` (the smaller one of
    acceleration and deceleration) and `jerk` are in rad, m, N, Nm and s, None if not stated or infinite. `mimic` is the joint
    that this one follows, with multiplier and offset.
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
    velocity: float | None = None
    effort: float | None = None
    acceleration: float | None = None
    jerk: float | None = None
    mimic: tuple[str, float, float] | None = None


@dataclass(frozen=True)
class Inertial:
    """The `mass` (kg) of a link, and its inertia about its centre of mass at `xyz` (m), in axes turned by `rpy` (rad) from those
    of the link. `inertia` is ixx, iyy, izz, ixy, ixz, iyz (kg m²).
    """

    mass: float
    xyz: tuple[float, float, float]
    rpy: tuple[float, float, float]
    inertia: tuple[float, float, float, float, float, float]


@dataclass(frozen=True)
class Urdf:
    """A tree of links; `joint_of_child` are keyed by the child link they carry, `inertials` by the link, those that state a mass.
    `notes` say what in the file has no effect, and what was made of the rest where that is not obvious, each as `file:line: what`.
    """

    links: tuple[str, ...]
    joint_of_child: dict[str, Joint]
    inertials: dict[str, Inertial]
    notes: tuple[str, ...] = ()

    def with_frames(self, fixed: Sequence[Joint]) -> Urdf:
        """The tree with one more link for each of these joints."""
        carried = {joint.child: joint for joint in fixed}
        return replace(self, links=(*self.links, *carried), joint_of_child={**self.joint_of_child, **carried})

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


def load_urdf(path: Path, grippers: Collection[str] = ()) -> Urdf:
    """Read a URDF file, in which joints may mimic those of `grippers`. Raises InvalidRequest with file, line and remedy; one
    line per fault.
    """
    try:
        text = path.read_bytes()
    except OSError as error:
        raise InvalidRequest(f"cannot read the URDF {path}: {error.strerror or error}") from error
    document = parse_urdf(path, text)
    account = account_for(document)
    links = tuple(document.attribute(link, "name") for link in document.root.findall("link"))
    joints: dict[str, Joint] = {}
    inertials: dict[str, Inertial] = {}
    faults: list[str] = []
    notes: list[str] = []
    for element in document.root.findall("link"):
        try:
            inertial = read_inertial(document, element)
        except InvalidRequest as error:
            faults.append(error.problem.message)
            continue
        if inertial is not None:
            inertials[document.attribute(element, "name")] = inertial
    for element in document.root.findall("joint"):
        try:
            joint = read_joint(document, element, notes)
            _check_drive(document, element, joint, grippers)
        except InvalidRequest as error:
            faults.append(error.problem.message)
            continue
        faults += [f"{document.place(element)}: {fault}" for fault in _misplaced(joint, links, joints)]
        joints[joint.child] = joint
    # A fault that was met in reading already is not said twice.
    places = {fault.split(": ")[0] for fault in faults}
    faults += [fault for fault in account.faults if fault.split(": ")[0] not in places]
    if faults:
        raise InvalidRequest("\n".join(faults))
    return Urdf(links, joints, inertials, (*account.notes, *notes))


def read_inertial(document: UrdfDocument, link: ET.Element) -> Inertial | None:
    """The <inertial> of a <link>, None without one, or if its mass is 0, as that of a frame is. Raises InvalidRequest with file and line."""
    element, owner = link.find("inertial"), f"link {link.get('name')}"
    if element is None:
        return None
    mass, inertia = element.find("mass"), element.find("inertia")
    kilograms = 0.0 if mass is None else document.numbers(mass, "value", 1, owner)[0]
    if mass is not None and kilograms < 0.0:
        raise document.fault(
            mass, f"{owner} has a mass of {kilograms:g} kg; write a positive one, or leave <inertial> out"
        )
    keys = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    xx, yy, zz, xy, xz, yz = (document.numbers(inertia, key, 1, owner, (0.0,))[0] for key in keys)
    xyz, rpy = document.origin(element.find("origin"), owner)
    return Inertial(kilograms, xyz, rpy, (xx, yy, zz, xy, xz, yz)) if kilograms > 0.0 else None


def read_joint(document: UrdfDocument, element: ET.Element, notes: list[str]) -> Joint:
    """A <joint>; `notes` get what is to be said about it. Raises InvalidRequest with file and line."""
    name = document.attribute(element, "name")
    owner = f"joint {name}"
    kind = _TYPES.get(document.attribute(element, "type"))
    if kind is None:
        known = ", ".join(_TYPES)
        raise document.fault(element, f"{owner} has the type {element.get('type')}; known are {known}")
    parent, child = (document.attribute(_end(document, element, tag, owner), "link") for tag in ("parent", "child"))
    xyz, rpy = document.origin(element.find("origin"), owner)
    limit = element.find("limit")
    speeds = {} if limit is None else dict(_speeds(document, limit, owner, notes))
    lower, upper = _range(document, element, kind, owner, notes)
    return Joint(
        name=name,
        type=kind,
        parent=parent,
        child=child,
        xyz=xyz,
        rpy=rpy,
        axis=_axis(document, element, kind, owner),
        lower=lower,
        upper=upper,
        velocity=speeds.get("velocity"),
        effort=speeds.get("effort"),
        acceleration=min((speeds[key] for key in ("acceleration", "deceleration") if key in speeds), default=None),
        jerk=speeds.get("jerk"),
        mimic=_mimic(document, element.find("mimic"), owner),
    )


def _end(document: UrdfDocument, element: ET.Element, tag: str, owner: str) -> ET.Element:
    end = element.find(tag)
    if end is None:
        raise document.fault(element, f"{owner} has no <{tag}>; write <{tag} link=.../>")
    return end


def _axis(document: UrdfDocument, element: ET.Element, kind: JointType, owner: str) -> tuple[float, float, float]:
    axis = element.find("axis")
    x, y, z = document.numbers(axis, "xyz", 3, owner, (1.0, 0.0, 0.0))
    if kind in ("fixed", "floating"):
        return (1.0, 0.0, 0.0)  # it has no meaning, and exporters write 0 0 0
    if (length := math.hypot(x, y, z)) < _MIN_AXIS_LENGTH:
        where = element if axis is None else axis
        raise document.fault(where, f"{owner} has the axis {x:g} {y:g} {z:g}; give it a direction, such as 0 0 1")
    return (x / length, y / length, z / length)


def _range(
    document: UrdfDocument, element: ET.Element, kind: JointType, owner: str, notes: list[str]
) -> tuple[float | None, float | None]:
    limit, safety = element.find("limit"), element.find("safety_controller")
    low = document.bound(limit, "lower", owner) if limit is not None else None
    high = document.bound(limit, "upper", owner) if limit is not None else None
    soft_low, soft_high = (
        document.bound(safety, key, owner) if safety is not None else None
        for key in ("soft_lower_limit", "soft_upper_limit")
    )
    if kind not in _LIMITED:
        if kind == "continuous":
            for where, one, other in ((limit, low, high), (safety, soft_low, soft_high)):
                if where is not None and (one or 0.0) != (other or 0.0) and not _endless(one, other):
                    notes.append(
                        f"{document.place(where)}: {owner} is continuous, so the limits {one or 0:g} to {other or 0:g} of its "
                        f'<{where.tag}> have no effect; write type="revolute" if they hold'
                    )
        return None, None
    if limit is None:
        return None, None
    low, high = low or 0.0, high or 0.0  # the specification's default for each
    if not (math.isfinite(low) and math.isfinite(high)):
        remedy = 'write type="continuous" if it turns freely, or' if kind == "revolute" else "write"
        raise document.fault(limit, f"{owner} ({kind}) has the limits {low:g} to {high:g}; {remedy} its real ones")
    if low > high:
        raise document.fault(limit, f"{owner} has its lower limit {low} above its upper limit {high}; swap them")
    if safety is None or (soft_low is None and soft_high is None):
        return low, high
    soft_low, soft_high = low if soft_low is None else soft_low, high if soft_high is None else soft_high
    place = document.place(safety)
    if soft_low > soft_high:
        raise document.fault(
            safety, f"{owner} has its soft lower limit {soft_low:g} above its soft upper limit {soft_high:g}; swap them"
        )
    inner, outer = max(low, soft_low), min(high, soft_high)
    if inner >= outer:
        if soft_low == soft_high == 0.0:
            notes.append(f"{place}: {owner} has both its soft limits at 0, which means none")
            return low, high
        raise document.fault(
            safety,
            f"{owner} has the soft limits {soft_low:g} to {soft_high:g}, which leave nothing of {low:g} to {high:g}; correct them",
        )
    if (soft_low < low and math.isfinite(soft_low)) or (soft_high > high and math.isfinite(soft_high)):
        notes.append(f"{place}: {owner} has soft limits {soft_low:g} to {soft_high:g} outside of {low:g} to {high:g}")
    if (inner, outer) != (low, high):
        notes.append(
            f"{place}: {owner} has soft limits: {inner:g} to {outer:g} are taken, not the {low:g} to {high:g} of its <limit>"
        )
    return inner, outer


def _endless(lower: float | None, upper: float | None) -> bool:
    return all(value is None or math.isinf(value) for value in (lower, upper))


def _speeds(document: UrdfDocument, limit: ET.Element, owner: str, notes: list[str]) -> Iterator[tuple[str, float]]:
    for key in ("velocity", "effort", "acceleration", "deceleration", "jerk"):
        if (value := document.bound(limit, key, owner)) is None:
            continue
        if value < 0.0:
            raise document.fault(limit, f"{owner} has a limit of {value:g} for its {key}; write it positive")
        if math.isinf(value) or (value == 0.0 and key not in ("velocity", "effort")):
            notes.append(
                f"{document.place(limit)}: {owner} has a limit of {value:g} for its {key}, which is taken as none"
            )
        else:
            yield key, value
    if len(both := {key for key in ("acceleration", "deceleration") if key in limit.attrib}) == 2:
        one, other = (limit.get(key) for key in sorted(both))
        if one != other:
            notes.append(
                f"{document.place(limit)}: {owner} may accelerate by {one} and decelerate by {other}; the smaller one is taken for both"
            )


def _mimic(document: UrdfDocument, mimic: ET.Element | None, owner: str) -> tuple[str, float, float] | None:
    if mimic is None:
        return None
    multiplier = document.numbers(mimic, "multiplier", 1, owner, (1.0,))[0]
    offset = document.numbers(mimic, "offset", 1, owner, (0.0,))[0]
    return document.attribute(mimic, "joint"), multiplier, offset


def _check_drive(document: UrdfDocument, element: ET.Element, joint: Joint, grippers: Collection[str]) -> None:
    """Raise InvalidRequest for a joint that no descriptor can use."""
    name = joint.name
    if joint.type not in (*_DRIVEN, "fixed"):
        raise document.fault(element, f"joint {name} is {joint.type}; known are {', '.join(_DRIVEN)}, fixed")
    if joint.mimic is not None and joint.mimic[0] not in grippers:
        mimic = element.find("mimic")
        where = element if mimic is None else mimic
        raise document.fault(
            where,
            f"joint {name} mimics {joint.mimic[0]}, which is not the joint of a gripper; name that in `grippers` of the descriptor, or "
            "make this one fixed at the position it is used in",
        )
    if joint.type not in _LIMITED:
        return
    limit = element.find("limit")
    if limit is None:
        raise document.fault(element, f"joint {name} ({joint.type}) needs <limit lower= upper=>")
    if joint.lower == joint.upper:
        raise document.fault(
            limit, f"joint {name} cannot move: both limits are {joint.lower}; give a range or make it fixed"
        )


def _misplaced(joint: Joint, links: tuple[str, ...], joints: dict[str, Joint]) -> Iterator[str]:
    """What keeps a joint from joining the tree of those before it."""
    for link in (joint.parent, joint.child):
        if link not in links:
            yield f"joint {joint.name} names the link {link}, which is not in the file; add <link name={link!r}/>"
    if any(joint.name == other.name for other in joints.values()):
        yield f"two joints are named {joint.name}; rename one"
    if joint.child in joints:
        yield f"the link {joint.child} has two parent joints, {joints[joint.child].name} and {joint.name}; keep one"
