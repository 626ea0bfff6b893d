"""The content of a URDF: links with their geometry, joints of all types, limits, mimics."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from zarm_contract import urdf
from zarm_contract.errors import InvalidRequest
from zarm_contract.urdf_elements import account_for
from zarm_robot_import.source import Source
from zarm_trajectory.arrays import Array

_MAX_NAME_LENGTH = 200
"""Characters of a link's name; YAML takes no key of more than 1024."""


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


@dataclass(frozen=True, kw_only=True)
class Joint(urdf.Joint):
    """One <joint>, with its element."""

    element: ET.Element

    @cached_property
    def origin(self) -> Array:
        """Its frame (4, 4) in the parent."""
        return _pose(self.xyz, self.rpy)

    def moved(self, value: float) -> Array:
        """The child's pose (4, 4) in the parent at a joint position."""
        return np.asarray(self.origin @ self.motions(np.array([value]))[0])

    def motions(self, values: Array) -> Array:
        """The child's motions (n, 4, 4) for joint positions (n,)."""
        found = np.tile(np.eye(4), (len(values), 1, 1))
        if self.type in ("revolute", "continuous"):
            found[:, :3, :3] = Rotation.from_rotvec(np.array(self.axis) * values[:, None]).as_matrix()
        elif self.type == "prismatic":
            found[:, :3, 3] = np.array(self.axis) * values[:, None]
        return found


@dataclass(frozen=True)
class Description:
    """A tree of links. `joint_of_child` holds the joint that carries each link, `children` the joints on each link; `notes` say
    what in the file has no effect, is left out, or is taken in another way than it is written."""

    source: Source
    name: str
    root: str
    links: dict[str, Link]
    joint_of_child: dict[str, Joint]
    children: dict[str, list[Joint]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

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
    account = account_for(source)
    notes = account.notes
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
        joint = Joint(**vars(urdf.read_joint(source, element, notes)), element=element)
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
    if account.faults:
        raise InvalidRequest("\n".join(account.faults))
    name = root.get("name") or source.path.stem
    kept = set(Description(source, name, roots[0], links, carried, children).below(roots[0]))
    notes += [_left_out(source, link, carried) for link in links.values() if link.name not in kept]
    notes += [
        f"{source.place(item)}: link {link.name} has a <{item.tag}> without a shape"
        for link in links.values()
        for item in link.element
        if item.tag in ("visual", "collision") and item.find("geometry/*") is None
    ]
    links = {link: links[link] for link in links if link in kept}
    return Description(source, name, roots[0], links, carried, children, tuple(notes))


def _left_out(source: Source, link: Link, carried: dict[str, Joint]) -> str:
    """What is said of a link in another tree than the robot's."""
    count = len(link.visual) + len(link.collision)
    shapes = f" with its {count} shape{'s' if count > 1 else ''}" if count else ""
    why = "no joint connects it to the robot" if link.name not in carried else "it is not part of the robot's tree"
    return f"{source.place(link.element)}: {link.name}: {why}, so it is left out{shapes}; add that joint"


def _link(source: Source, element: ET.Element) -> Link:
    name = source.attribute(element, "name")
    if len(name) > _MAX_NAME_LENGTH:
        raise source.fault(
            element, f"the name of a link has {len(name)} characters, more than {_MAX_NAME_LENGTH}; shorten it"
        )
    urdf.read_inertial(source, element)
    found = {tag: tuple(_geometries(source, element, tag, name)) for tag in ("visual", "collision")}
    return Link(name, element, **found)


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
        pose = _pose(*source.origin(item.find("origin"), f"link {name}"))
        match shape.tag:
            case "mesh":
                scale = source.numbers(shape, "scale", 3, f"link {name}", (1.0, 1.0, 1.0))
                file = source.attribute(shape, "filename")
                yield Geometry("mesh", pose, shape, file=file, scale=(scale[0], scale[1], scale[2]))
            case "box":
                yield Geometry("box", pose, shape, size=source.numbers(shape, "size", 3, f"link {name}"))
            case "cylinder" | "capsule":
                radius, length = (source.numbers(shape, key, 1, f"link {name}")[0] for key in ("radius", "length"))
                yield Geometry(shape.tag, pose, shape, size=(radius, length))
            case "sphere":
                yield Geometry("sphere", pose, shape, size=source.numbers(shape, "radius", 1, f"link {name}"))
            case _:
                raise source.fault(
                    shape, f"link {name} has the geometry <{shape.tag}>; use mesh, box, cylinder or sphere"
                )


def _pose(xyz: tuple[float, float, float], rpy: tuple[float, float, float]) -> Array:
    pose = np.eye(4)
    pose[:3, 3] = xyz
    pose[:3, :3] = Rotation.from_euler("xyz", rpy).as_matrix()  # about fixed axes, as in the specification
    return pose
