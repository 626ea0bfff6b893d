"""The files of an imported robot: its URDF with the arm alone, and its descriptor."""

from __future__ import annotations

import copy
import os
import re
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from zarm_contract.collision import CollisionPrimitive
from zarm_robot_import.chain import Chain
from zarm_robot_import.description import Description
from zarm_robot_import.fitting import Fitted
from zarm_robot_import.gripper import ImportedGripper
from zarm_robot_import.limits import JointLimits
from zarm_robot_import.self_collision import Pair
from zarm_trajectory.arrays import Array

_PLAIN = re.compile(r"[A-Za-z_][\w.-]*", re.ASCII)
_WORDS = {"true", "false", "yes", "no", "on", "off", "null", "y", "n"}


def urdf_text(
    robot: Description,
    chain: Chain,
    limits: Sequence[JointLimits],
    folder: Path,
    grippers: Mapping[str, ImportedGripper],
) -> str:
    """The arm as a URDF for a file in `folder`: its links as in the source; only its joints move, and those of its grippers."""
    root = ET.Element("robot", name=robot.name)
    root.append(ET.Comment(f" Made by zarm robot import from {_shown(robot.source.path)}. "))
    for mounted in chain.mounted:
        link = copy.deepcopy(robot.links[mounted.link].element)
        for mesh in link.iter("mesh"):
            if found := robot.source.file(mesh.get("filename", "")):
                mesh.set("filename", os.path.relpath(found, folder))
        for visual in link.findall("visual"):
            for material in visual.findall("material"):
                if not len(material):  # a material defined elsewhere in the source
                    visual.remove(material)
        link.tail = "\n"
        root.append(link)
    for index, (joint, limit) in enumerate(zip(chain.joints, limits, strict=True)):
        carrier = chain.carriers[chain.parents[index]]
        element = _joint(joint.name, joint.type, carrier, chain.carriers[index + 1], chain.origins[index])
        ET.SubElement(element, "axis", xyz=_numbers(joint.axis))
        effort = f"{joint.effort if joint.effort is not None else 0:g}"
        bounds = {} if joint.type == "continuous" else {"lower": f"{limit.lower:.9g}", "upper": f"{limit.upper:.9g}"}
        ET.SubElement(element, "limit", bounds | {"velocity": f"{limit.velocity:.9g}", "effort": effort})
        root.append(element)
    names = {joint.name for joint in chain.joints}
    for gripper in grippers.values():
        root.extend(_gripper_joints(robot, chain, gripper))
        names |= {element.get("name", "") for element in root.findall("joint")}
    gripping = {link for gripper in grippers.values() for link in gripper.moving}
    for mounted in chain.mounted:
        carrier = chain.carriers[mounted.body]
        if mounted.link != carrier and mounted.link not in gripping:
            name = f"{mounted.link}_fixed"
            while name in names:
                name += "_"
            names.add(name)
            root.append(_joint(name, "fixed", carrier, mounted.link, mounted.pose))
    ET.indent(root)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _gripper_joints(robot: Description, chain: Chain, gripper: ImportedGripper) -> Iterator[ET.Element]:
    """The joint of each link that moves with the gripper."""
    stands = dict(chain.fixed)
    for link in gripper.moving:
        joint = robot.joint_of_child[link]
        follows = gripper.followers.get(joint.name)
        if joint.name != gripper.joint.name and follows is None:
            yield _joint(joint.name, "fixed", joint.parent, link, joint.moved(stands.get(joint.name, 0.0)))
            continue
        element = _joint(joint.name, joint.type, joint.parent, link, joint.origin)
        ET.SubElement(element, "axis", xyz=_numbers(joint.axis))
        low, high = sorted((gripper.positions[0], gripper.positions[-1]))
        if follows is not None:
            multiplier, offset = follows
            low, high = sorted((multiplier * low + offset, multiplier * high + offset))
            ET.SubElement(
                element, "mimic", joint=gripper.joint.name, multiplier=f"{multiplier:.12g}", offset=f"{offset:.12g}"
            )
        if joint.type != "continuous":
            numbers = {"lower": low, "upper": high, "velocity": joint.velocity or 0.0, "effort": joint.effort or 0.0}
            ET.SubElement(element, "limit", {key: f"{value:.9g}" for key, value in numbers.items()})
        yield element


def _joint(name: str, kind: str, parent: str, child: str, origin: Array) -> ET.Element:
    element = ET.Element("joint", name=name, type=kind)
    ET.SubElement(element, "parent", link=parent)
    ET.SubElement(element, "child", link=child)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # at a pitch of 90 degrees the third angle is arbitrary
        rpy = Rotation.from_matrix(origin[:3, :3]).as_euler("xyz")
    ET.SubElement(element, "origin", xyz=_numbers(origin[:3, 3]), rpy=_numbers(rpy))
    return element


def _numbers(values: Array | tuple[float, ...]) -> str:
    return " ".join(f"{value:.12g}" for value in np.where(np.abs(values) < 1e-12, 0.0, values))


def descriptor_text(
    name: str,
    source: Path,
    chain: Chain,
    limits: Sequence[JointLimits],
    fitted: Sequence[Fitted],
    home: Sequence[float],
    pairs: Sequence[Pair],
    controller: str | None = None,
    grippers: Mapping[str, ImportedGripper] | None = None,
) -> str:
    """The descriptor. `controller` is the ros2_control trajectory controller that moves the arm."""
    assumed = sorted({what for limit in limits for what in limit.assumed})
    lines = [
        f"# {name}, made by `zarm robot import` from {source.name}; {name}.md says how each number was found.",
        "# docs/reference/robot.md explains the keys and units. Lengths in m, angles in rad, times in s.",
        "",
        f"name: {name}",
        f"urdf: {name}.urdf",
        f"base_link: {plain(chain.base)}",
        f"tip_link: {plain(chain.tip)}",
        f"joints: [{', '.join(plain(joint.name) for joint in chain.joints)}]",
        *_groups(chain),
        "",
        "# Free, far from joint limits and singularities.",
        f"home: {_list(home)}",
        "",
        f"# Assumed, because the URDF does not say it: {', '.join(assumed)}. Replace it by what the arm's manual says."
        if assumed
        else "# As the URDF says.",
        "cspace:",
        *(
            f"  {key}: {_list([getattr(limit, key) for limit in limits])}"
            for key in ("velocity", "acceleration", "jerk")
        ),
        "",
        "strategy: emulator",
        *(_driver(controller) if controller else ()),
        *(_grippers(grippers) if grippers else ()),
        "",
        "# Exact geometry: it contains the whole surface of the meshes.",
        "collision:",
    ]
    for link in fitted:
        lines += _primitives(link.link, link.primitives)
    lines += ["", "# The sphere cover of the search: it contains the geometry above.", "spheres:"]
    for link in fitted:
        lines += _spheres(link.link, link.balls)
    ignored = [pair for pair in pairs if pair.ignored]
    lines += ["", "self_collision_ignore:" if ignored else "self_collision_ignore: []"]
    lines += [f"  - [{plain(pair.first)}, {plain(pair.second)}]  # {pair.reason}" for pair in ignored]
    if close := [pair for pair in pairs if pair.exact]:
        lines += ["", "self_collision_exact:"]
        lines += [f"  - [{plain(pair.first)}, {plain(pair.second)}]  # {pair.reason}" for pair in close]
    return "\n".join(lines) + "\n"


def _driver(controller: str) -> list[str]:
    return [
        "",
        "# The trajectory controller that the URDF's <ros2_control> names. `strategy: joint_trajectory` moves the real arm.",
        "strategy_params:",
        f"  command_topic: /{controller.strip('/')}/joint_trajectory",
        f"  action: /{controller.strip('/')}/follow_joint_trajectory",
        "  joint_states_topic: /joint_states",
        "  strategies: [joint_trajectory]",
    ]


def _groups(chain: Chain) -> list[str]:
    if not chain.groups:
        return []
    lines = ["", "# What a plan may move while the other joints stand.", "groups:"]
    for group in chain.groups:
        joints = ", ".join(map(plain, group.joints))
        lines.append(f"  {group.name}: {{tip_link: {plain(group.tip)}, joints: [{joints}]}}")
    return lines


def _grippers(grippers: Mapping[str, ImportedGripper]) -> list[str]:
    lines = [
        "",
        "# Behind the arm one joint moves fingers. The openings are measured between the meshes of the pads; correct them where the pads are",
        "# shaped, and state the speed (m/s) and force (N) of the gripper.",
        "grippers:",
    ]
    for name, gripper in grippers.items():
        lines += _gripper(name, gripper)
    return lines


def _gripper(name: str, gripper: ImportedGripper) -> list[str]:
    lines = [
        f"  {name}:",
        f"    joint: {plain(gripper.joint.name)}",
        f"    positions: {_list(gripper.positions)}",
        f"    widths: {_list(gripper.widths)}",
        f"    pads: [{', '.join(map(plain, gripper.pads))}]",
    ]
    if speed := gripper.speed:
        lines.append(f"    speed: {speed:.3g}")
    if gripper.joint.type == "prismatic" and gripper.joint.effort:
        lines.append(f"    force: {gripper.joint.effort:.9g}")
    return lines


def plain(text: str) -> str:
    """A name that YAML reads as text."""
    if _PLAIN.fullmatch(text) and text.lower() not in _WORDS:
        return text
    return f'"{"".join(map(_escaped, text))}"'


def _escaped(character: str) -> str:
    """As YAML writes it in quotes. JSON would write an emoji as two surrogates, which are no characters to YAML."""
    if character in '"\\':
        return f"\\{character}"
    return character if character.isprintable() else f"\\U{ord(character):08x}"


def _shown(file: Path) -> str:
    """A file's name in a comment, which ends at a line break in YAML, and at `--` in XML."""
    return "".join(one if one.isprintable() else " " for one in file.name).replace("--", "- -").replace("--", "- -")


def _list(values: Sequence[float]) -> str:
    return f"[{', '.join(f'{value:.9g}' for value in values)}]"


def _primitives(link: str, primitives: Sequence[CollisionPrimitive]) -> list[str]:
    """Unrounded, because rounding would let the surface out."""
    rows = []
    for primitive in primitives:
        values = primitive.model_dump().items()
        shown = (f"{key}: {_list(value) if isinstance(value, tuple) else value}" for key, value in values)
        rows.append(f"    - {{{', '.join(shown)}}}")
    return [f"  {plain(link)}:", *rows]


def _spheres(link: str, balls: Array) -> list[str]:
    rows = [
        f"    - {{center: [{x + 0.0:.4f}, {y + 0.0:.4f}, {z + 0.0:.4f}], radius: {radius:.4f}}}"
        for x, y, z, radius in np.round(balls, 4).tolist()
    ]
    return [f"  {plain(link)}:", *rows]
