"""The content of a URDF: links with their geometry, joints of all types, limits, mimics."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from zarm_robot_import.source import Source

Array = NDArray[np.float64]

_SHORTEST = 1e-9
"""Length of an axis, at least."""
_LONGEST = 200
"""Characters of a link's name; YAML takes no key of more than 1024."""
TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")


@dataclass(frozen=True)
class Geometry:
    """One <visual> or <collision>: a mesh `file` (as written) with `scale`, or a primitive of `size`; `pose` in the link."""

    kind: str
    pose: Array
    element: ET.Element
    file: str = ""
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    size: tuple[float, ...] = ()


_INERTIA = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
"""The attributes of <inertia>."""


@dataclass(frozen=True)
class Link:
    """One <link>."""

    name: str
    element: ET.Element
    visual: tuple[Geometry, ...]
    collision: tuple[Geometry, ...]

    @property
    def inertia(self) -> Array | None:
        """The inertia tensor (3, 3) in kg m^2 about the centre of mass, None if the URDF states none."""
        stated = self.element.find("inertial/inertia")
        if stated is None:
            return None
        xx, xy, xz, yy, yz, zz = (float(stated.get(key, "0")) for key in _INERTIA)
        return np.array(((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)))


@dataclass(frozen=True)
class Joint:
    """One <joint>; `origin` (4, 4) in the parent, limits in rad (m if prismatic), None if not given."""

    name: str
    type: str
    parent: str
    child: str
    origin: Array
    axis: Array
    lower: float | None
    upper: float | None
    velocity: float | None
    effort: float | None
    mimic: tuple[str, float, float] | None
    element: ET.Element

    def moved(self, value: float) -> Array:
        """The child's pose (4, 4) in the parent at a joint position."""
        return np.asarray(self.origin @ self.motions(np.array([value]))[0])

    def motions(self, values: Array) -> Array:
        """The child's motions (n, 4, 4) for joint positions (n,)."""
        found = np.tile(np.eye(4), (len(values), 1, 1))
        if self.type in ("revolute", "continuous"):
            found[:, :3, :3] = Rotation.from_rotvec(self.axis * values[:, None]).as_matrix()
        elif self.type == "prismatic":
            found[:, :3, 3] = self.axis * values[:, None]
        return found


@dataclass(frozen=True)
class Description:
    """A tree of links. `joint_of_child` holds the joint that carries each link, `children` the joints on each link; links in
    `stray` have geometry, but hang on no joint, and are left out."""

    source: Source
    name: str
    root: str
    links: dict[str, Link]
    joint_of_child: dict[str, Joint]
    children: dict[str, list[Joint]] = field(default_factory=dict)
    stray: tuple[str, ...] = ()

    def path(self, base: str, tip: str) -> list[Joint] | None:
        """The joints from `base` to `tip`, None if `tip` is not below `base`."""
        found: list[Joint] = []
        link = tip
        while link != base:
            if link not in self.joint_of_child:
                return None
            found.append(self.joint_of_child[link])
            link = found[-1].parent
        return found[::-1]

    def below(self, link: str) -> Iterator[str]:
        """A link and all links below it."""
        waiting = [link]
        while waiting:
            yield (one := waiting.pop())
            waiting += [joint.child for joint in reversed(self.children.get(one, ()))]


def describe(source: Source) -> Description:
    """Read a URDF's content. Raises InvalidRequest with file, line and remedy."""
    root = source.root
    links: dict[str, Link] = {}
    for element in root.findall("link"):
        link = _link(source, element)
        if link.name in links:
            raise source.fault(element, f"two links are named {link.name}; rename one")
        links[link.name] = link
    joints: dict[str, Joint] = {}
    carried: dict[str, Joint] = {}
    children: dict[str, list[Joint]] = {}
    for element in root.findall("joint"):
        joint = _joint(source, element)
        if joint.name in joints:
            raise source.fault(element, f"two joints are named {joint.name}; rename one")
        for end in (joint.parent, joint.child):
            if end not in links:
                raise source.fault(
                    element, f"joint {joint.name} names the link {end}, which is not in the file; add it"
                )
        if joint.child in carried:
            other = carried[joint.child].name
            raise source.fault(
                element, f"the link {joint.child} has two parent joints, {other} and {joint.name}; keep one"
            )
        joints[joint.name] = carried[joint.child] = joint
        children.setdefault(joint.parent, []).append(joint)
    for joint in joints.values():
        loop, above = {joint.name: joint}, joint.parent
        while above in carried and carried[above].name not in loop:
            loop[carried[above].name] = carried[above]
            above = carried[above].parent
        if above == joint.child:
            last = max(loop.values(), key=lambda one: source.lines[one.element])
            raise source.fault(
                last.element,
                f"the joints {', '.join(reversed(loop))} close a loop; a URDF is a tree, so take one of them out",
            )
    roots = [name for name in links if name not in carried]
    if not links:
        raise source.fault(root, "there is no <link> in this file; is it a robot?")
    if len(roots) > 1:
        # Stray links, such as `world` in some files, carry nothing.
        roots = [name for name in roots if children.get(name)] or roots
    if len(roots) > 1:
        raise source.fault(
            links[roots[1]].element,
            f"{' and '.join(roots)} have no parent; a URDF has one root, so join them with a joint",
        )
    name = root.get("name") or source.path.stem
    kept = set(Description(source, name, roots[0], links, carried, children).below(roots[0]))
    stray = tuple(link.name for link in links.values() if link.name not in kept and (link.visual or link.collision))
    links = {link: links[link] for link in links if link in kept}
    return Description(source, name, roots[0], links, carried, children, stray)


def _link(source: Source, element: ET.Element) -> Link:
    name = _attribute(source, element, "name")
    if len(name) > _LONGEST:
        raise source.fault(element, f"the name of a link has {len(name)} characters, more than {_LONGEST}; shorten it")
    _check_inertial(source, element.find("inertial"), f"link {name}")
    found = {tag: tuple(_geometries(source, element, tag, name)) for tag in ("visual", "collision")}
    return Link(name, element, **found)


def _check_inertial(source: Source, inertial: ET.Element | None, owner: str) -> None:
    if inertial is None:
        return
    mass, inertia = inertial.find("mass"), inertial.find("inertia")
    if mass is not None and (kilograms := _numbers(source, mass, "value", 1, owner)[0]) < 0.0:
        raise source.fault(
            mass, f"{owner} has a mass of {kilograms:g} kg; write a positive one, or leave <inertial> out"
        )
    for key in _INERTIA:
        _numbers(source, inertia, key, 1, owner, (0.0,))


def _geometries(source: Source, link: ET.Element, tag: str, name: str) -> Iterator[Geometry]:
    for geometry in _stated(source, link, tag, name):
        if any(size < 0.0 for size in geometry.size):
            raise source.fault(
                geometry.element, f"link {name}: a <{geometry.kind}> has a negative size; write it positive"
            )
        yield geometry


def _stated(source: Source, link: ET.Element, tag: str, name: str) -> Iterator[Geometry]:
    for item in link.findall(tag):
        shape = next(iter(item.findall("geometry/*")), None)
        if shape is None:
            continue
        pose = _pose(source, item.find("origin"), f"link {name}")
        match shape.tag:
            case "mesh":
                scale = _numbers(source, shape, "scale", 3, f"link {name}", (1.0, 1.0, 1.0))
                file = _attribute(source, shape, "filename")
                yield Geometry("mesh", pose, shape, file=file, scale=(scale[0], scale[1], scale[2]))
            case "box":
                yield Geometry("box", pose, shape, size=_numbers(source, shape, "size", 3, f"link {name}"))
            case "cylinder" | "capsule":
                radius, length = (_numbers(source, shape, key, 1, f"link {name}")[0] for key in ("radius", "length"))
                yield Geometry(shape.tag, pose, shape, size=(radius, length))
            case "sphere":
                yield Geometry("sphere", pose, shape, size=_numbers(source, shape, "radius", 1, f"link {name}"))
            case _:
                raise source.fault(
                    shape, f"link {name} has the geometry <{shape.tag}>; use mesh, box, cylinder or sphere"
                )


def _joint(source: Source, element: ET.Element) -> Joint:
    name = _attribute(source, element, "name")
    kind = _attribute(source, element, "type")
    if kind not in TYPES:
        raise source.fault(element, f"joint {name} has the type {kind}; known are {', '.join(TYPES)}")
    ends = []
    for tag in ("parent", "child"):
        end = element.find(tag)
        if end is None:
            raise source.fault(element, f"joint {name} has no <{tag}>; write <{tag} link=.../>")
        ends.append(_attribute(source, end, "link"))
    axis = np.array(_numbers(source, element.find("axis"), "xyz", 3, f"joint {name}", (1.0, 0.0, 0.0)))
    if kind in ("revolute", "continuous", "prismatic"):
        if (length := math.hypot(*axis)) < _SHORTEST:
            written = " ".join(f"{value:g}" for value in axis)
            raise source.fault(element, f"joint {name} has the axis {written}; give it a direction, such as 0 0 1")
        axis = axis / length
    limit = element.find("limit")
    bounds: dict[str, float | None] = {
        key: _numbers(source, limit, key, 1, f"joint {name}")[0] if limit is not None and limit.get(key) else None
        for key in ("lower", "upper", "velocity", "effort")
    }
    if limit is not None and kind in ("revolute", "prismatic"):
        # The specification's default for each is 0.
        bounds |= {key: bounds[key] or 0.0 for key in ("lower", "upper")}
    mimic = element.find("mimic")
    copied = None
    if mimic is not None:
        factor, shift = (
            _numbers(source, mimic, key, 1, f"joint {name}", (default,))[0]
            for key, default in (("multiplier", 1.0), ("offset", 0.0))
        )
        copied = (_attribute(source, mimic, "joint"), factor, shift)
    return Joint(
        name=name,
        type=kind,
        parent=ends[0],
        child=ends[1],
        origin=_pose(source, element.find("origin"), f"joint {name}"),
        axis=axis,
        mimic=copied,
        element=element,
        lower=bounds["lower"],
        upper=bounds["upper"],
        velocity=bounds["velocity"],
        effort=bounds["effort"],
    )


def _attribute(source: Source, element: ET.Element, name: str) -> str:
    value = element.get(name)
    if not value:
        raise source.fault(element, f"a <{element.tag}> has no {name}=")
    return value


def _numbers(
    source: Source,
    element: ET.Element | None,
    name: str,
    count: int,
    owner: str,
    default: tuple[float, ...] | None = None,
) -> tuple[float, ...]:
    if element is None or (text := element.get(name)) is None:
        if default is None:
            where = source.root if element is None else element
            raise source.fault(where, f"{owner}: its <{where.tag}> has no {name}=; write it")
        return default
    try:
        values = tuple(map(float, text.split()))
    except ValueError:
        values = ()
    if len(values) != count or not all(map(math.isfinite, values)):
        hint = "; this is a xacro file: name it .xacro" if "$" in text else ""
        wanted = "a finite number" if count == 1 else f"{count} finite numbers"
        raise source.fault(element, f"{owner}: {name}={text!r} must be {wanted}{hint}")
    return values


def _pose(source: Source, origin: ET.Element | None, owner: str) -> Array:
    pose = np.eye(4)
    pose[:3, 3] = _numbers(source, origin, "xyz", 3, owner, (0.0, 0.0, 0.0))
    rpy = _numbers(source, origin, "rpy", 3, owner, (0.0, 0.0, 0.0))
    pose[:3, :3] = Rotation.from_euler("xyz", rpy).as_matrix()  # about fixed axes, as in the specification
    return pose
