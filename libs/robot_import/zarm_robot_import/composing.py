"""One robot of several: arms beside each other, or on a torso or an axis, as a composition file lists them."""

from __future__ import annotations

import copy
import os
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

import yaml
from pydantic import Field

from zarm_contract.document import Document
from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import Vector3
from zarm_contract.robot import RobotDescription, load_robot
from zarm_contract.section import Section, read_section
from zarm_contract.urdf_document import parse_urdf

_ACCELERATION_SHARE = 0.93
"""Share of the largest acceleration of a robot that another executor leads: what that commands while it brakes exceeds its limits by up to
5 %, and each executor checks what it is told to do."""
_KEPT = ("link", "joint")
"""The elements of a URDF that describe its geometry and kinematics; materials are those of its links."""


class Part(Section):
    """One robot of a composition."""

    robot: str
    """A descriptor, relative to the composition file, or the name of a robot that comes with zarm."""
    on: str | None = None
    """The part whose tip carries this one. Left out: it stands on `base_link`."""
    xyz: Vector3 = (0.0, 0.0, 0.0)
    """Where its base is (m), in the frame of `base_link`, or of the tip of the part that carries it."""
    executor: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,63}$")] | None = None
    """The name on the bus of this robot alone, if it has an executor of its own: that moves it, in step with the others. All parts have one, or
    none."""
    rpy: Vector3 = (0.0, 0.0, 0.0)
    """Its turn (rad) about the fixed axes x, y and z, one after the other, as in a URDF."""


class Composition(Section):
    """Several robots as one. Every link, joint and gripper gets the name of its part in front."""

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,63}$")]
    """The name of the whole robot."""
    base_link: str = "base"
    """The name of the link on which the parts stand."""
    parts: dict[Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,30}$")], Part] = Field(min_length=1, max_length=8)
    """The robots by the names of their groups; one that carries others comes before them."""


def read_composition(path: Path) -> tuple[Composition, dict[str, RobotDescription]]:
    """A composition with the robot of each part. Raises InvalidRequest with file, line and remedy."""
    document, composition = read_section(path, "a composition of robots", Composition)
    if faults := [*_misplaced(document, composition)]:
        raise InvalidRequest("\n".join(faults))
    robots = {}
    for name, part in composition.parts.items():
        beside = path.parent / part.robot
        try:
            robots[name] = load_robot(str(beside) if beside.is_file() else part.robot)
        except InvalidRequest as error:
            raise InvalidRequest(document.fault(("parts", name, "robot"), error.problem.message)) from error
        if robots[name].descriptor.groups:
            message = f"{part.robot} has groups itself; list its arms here one by one"
            raise InvalidRequest(document.fault(("parts", name, "robot"), message))
    return composition, robots


def _misplaced(document: Document, composition: Composition) -> Iterator[str]:
    """Parts that stand on none that comes before them."""
    before: list[str] = []
    for name, part in composition.parts.items():
        if part.on is not None and part.on not in before:
            known = f"those are {', '.join(before)}" if before else "it is the first one; leave `on` out"
            yield document.fault(("parts", name, "on"), f"{part.on} is not a part that comes before {name}: {known}")
        before.append(name)
    own = [name for name, part in composition.parts.items() if part.executor is not None]
    if own and len(own) < len(before):
        missing = next(name for name in before if name not in own)
        yield document.fault(
            ("parts", missing), f"{missing} has no executor, and {own[0]} has one; give all parts one, or none"
        )


def compose(path: Path, folder: Path | None, overwrite: bool = False) -> Path:
    """Write the descriptor and the URDF of a composition to `folder`, by default one of the robot's name, once they are read without a fault; returns the
    descriptor's path. Raises InvalidRequest.
    """
    composition, robots = read_composition(path)
    folder = folder or Path(composition.name)
    descriptor, urdf = folder / f"{composition.name}.yaml", folder / f"{composition.name}.urdf"
    for file in (descriptor, urdf):
        if file.exists() and not overwrite:
            raise InvalidRequest(f"{file} is there already; --overwrite replaces it")
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(
        dir=folder.parent, prefix=f"{folder.name}-"
    ) as name:  # as deep, so that relative paths hold
        trial = Path(name)
        (trial / urdf.name).write_text(_urdf_text(composition, robots, folder, path), encoding="utf-8")
        (trial / descriptor.name).write_text(_descriptor_text(composition, robots, path), encoding="utf-8")
        try:
            load_robot(str(trial / descriptor.name))
        except InvalidRequest as error:
            raise InvalidRequest(error.problem.message.replace(f"{trial}/", f"{path}: made of it, ")) from error
        folder.mkdir(exist_ok=True)
        for file in (urdf, descriptor):
            (trial / file.name).replace(file)
    return descriptor


def _urdf_text(composition: Composition, robots: Mapping[str, RobotDescription], folder: Path, source: Path) -> str:
    root = ET.Element("robot", name=composition.name)
    root.append(ET.Comment(f" Made by zarm robot compose from {source.name}. "))
    ET.SubElement(root, "link", name=composition.base_link)
    taken = {_named(name, joint.name) for name, robot in robots.items() for joint in robot.urdf.joint_of_child.values()}
    for name, part in composition.parts.items():
        robot = robots[name]
        carrier = composition.base_link
        if part.on is not None:
            carrier = _named(part.on, robots[part.on].descriptor.tip_link)
        mounting = f"{name}_mount"
        while mounting in taken:
            mounting += "_"
        mount = ET.SubElement(root, "joint", name=mounting, type="fixed")
        ET.SubElement(mount, "parent", link=carrier)
        ET.SubElement(mount, "child", link=_named(name, robot.descriptor.base_link))
        ET.SubElement(mount, "origin", xyz=_numbers(part.xyz), rpy=_numbers(part.rpy))
        for element in parse_urdf(robot.urdf_path, robot.urdf_path.read_bytes()).root:
            if element.tag in _KEPT and _hangs_on_base(robot, element):
                root.append(_renamed(name, element, robot.urdf_path.parent, folder))
    ET.indent(root)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _hangs_on_base(robot: RobotDescription, element: ET.Element) -> bool:
    """Whether a link or a joint belongs to what the base link carries."""
    child = element.find("child")
    link = element.get("name", "") if element.tag == "link" else "" if child is None else child.get("link", "")
    base = robot.descriptor.base_link
    if link == base:
        return element.tag == "link"
    try:
        robot.urdf.chain(base, link)
    except InvalidRequest:
        return False
    return True


def _renamed(part: str, element: ET.Element, was: Path, folder: Path) -> ET.Element:
    """A link or joint of a part with the names of the whole robot, and its meshes as seen from `folder`."""
    made = copy.deepcopy(element)
    made.set("name", _named(part, made.get("name", "")))
    for end in (*made.findall("parent"), *made.findall("child")):
        end.set("link", _named(part, end.get("link", "")))
    for mimic in made.findall("mimic"):
        mimic.set("joint", _named(part, mimic.get("joint", "")))
    for material in made.iter("material"):
        if material.get("name"):
            material.set("name", _named(part, material.get("name", "")))
    for mesh in made.iter("mesh"):
        file = mesh.get("filename", "")
        if "://" not in file:
            mesh.set("filename", os.path.relpath(was / file, folder))
    for visual in made.findall("visual"):
        for material in visual.findall("material"):
            if not len(material):  # a material defined elsewhere in the source
                visual.remove(material)
    return made


def _named(part: str, name: str) -> str:
    return f"{part}_{name}"


def _numbers(values: Vector3) -> str:
    return " ".join(f"{value:.12g}" for value in values)


def _descriptor_text(composition: Composition, robots: Mapping[str, RobotDescription], source: Path) -> str:
    whole: dict[str, Any] = {
        "name": composition.name,
        "urdf": f"{composition.name}.urdf",
        "base_link": composition.base_link,
        "tip_link": "",
        "joints": [],
        "home": [],
        "cspace": {"velocity": [], "acceleration": [], "jerk": []},
        "groups": {},
        "grippers": {},
        "outputs": {},
        "payloads": {},
        "tools": {},
        "executors": {},
    }
    sections: dict[str, Any] = {"collision": {}, "spheres": {}, "self_collision_ignore": [], "self_collision_exact": []}
    periods = []
    for name, part in composition.parts.items():
        described = robots[name].descriptor
        own: dict[str, Any] = described.model_dump(mode="json", exclude_unset=True)
        joints = [_named(name, joint) for joint in described.joints]
        tip = _named(name, described.tip_link)
        whole["tip_link"] = whole["tip_link"] or tip
        whole["joints"] += joints
        whole["home"] += own["home"]
        for limit in whole["cspace"]:
            share = _ACCELERATION_SHARE if part.executor is not None and limit == "acceleration" else 1.0
            whole["cspace"][limit] += [round(share * each, 6) for each in own["cspace"][limit]]
        if part.executor is not None:
            delay = 0.0 if described.strategy_params is None else described.strategy_params.delay
            whole["executors"][name] = {"robot": part.executor, "delay": delay}
        whole["groups"][name] = {"tip_link": tip}
        if part.on is not None:
            whole["groups"][name]["joints"] = joints
            whole["groups"][f"{part.on}+{name}"] = {"tip_link": tip}
        for gripper, section in own.get("grippers", {}).items():
            section = section | {"joint": _named(name, section["joint"])}
            section["pads"] = [_named(name, pad) for pad in section["pads"]]
            section.pop("action", None)
            whole["grippers"][_named(name, gripper)] = section
        whole["outputs"] |= {
            _named(name, output): {key: value for key, value in section.items() if key != "service"}
            for output, section in own.get("outputs", {}).items()
        }
        whole["payloads"] |= {_named(name, link): section for link, section in own.get("payloads", {}).items()}
        for tool, section in own.get("tools", {}).items():
            touched = [_named(name, link) for link in section.get("touch_links", ())]
            carrier = _named(name, section.get("link") or described.tip_link)
            whole["tools"][_named(name, tool)] = section | {"link": carrier, "touch_links": touched}
        for section in ("collision", "spheres"):
            sections[section] |= {_named(name, link): own[section][link] for link in own[section]}
        for section in ("self_collision_ignore", "self_collision_exact"):
            sections[section] += [[_named(name, link) for link in pair] for pair in own.get(section, ())]
        periods.append(described.interpolation_dt)
    whole["interpolation_dt"] = min(periods)
    if whole["executors"]:
        whole["strategy"] = "executors"
    head = (
        f"# {composition.name}, made by `zarm robot compose` from {source.name}.\n"
        "# docs/reference/robot.md explains the keys and units. Lengths in m, angles in rad, times in s.\n"
    )
    kept = {key: value for key, value in (whole | sections).items() if value != {}}
    texts = (yaml.safe_dump({key: value}, sort_keys=False, width=140) for key, value in kept.items())
    return "\n".join((head, *texts))
