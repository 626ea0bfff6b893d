"""The semantic description of a robot, made from its descriptor."""

from __future__ import annotations

import itertools
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence

from zarm_contract.robot import RobotDescription


def semantic_description(robot: RobotDescription, group: str) -> str:
    """The SRDF: the group of all joints and those of the descriptor, each with its named state `home`, one for each gripper with `open` and
    `close`, and the pairs of links that are not checked.
    """
    descriptor = robot.descriptor
    root = ET.Element("robot", name=_urdf_name(robot))
    if not descriptor.groups:
        _add_chain(root, group, descriptor.base_link, descriptor.tip_link)
    else:
        _add_joints(root, group, descriptor.joints)
    _add_home(root, group, robot)
    for name in descriptor.groups:
        _add_group(root, robot, name)
        _add_home(root, name, robot.group(name))
    for name in descriptor.grippers:
        _add_gripper(root, robot, group, name)
    for one, other, reason in _unchecked(robot):
        ET.SubElement(root, "disable_collisions", link1=one, link2=other, reason=reason)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode")


def _add_group(root: ET.Element, robot: RobotDescription, name: str) -> None:
    """A chain from the link that carries the first joint, where there is no other joint on the way."""
    joints, tip = robot.group_joints(name), robot.descriptor.groups[name].tip_link
    if tip is not None:
        chain = robot.urdf.chain(robot.descriptor.base_link, tip)
        first = next(joint for joint in chain if joint.name in joints)
        beyond = robot.urdf.chain(first.parent, tip)
        if tuple(joint.name for joint in beyond if joint.type != "fixed") == joints:
            _add_chain(root, name, first.parent, tip)
            return
    _add_joints(root, name, joints)


def _add_chain(root: ET.Element, group: str, base: str, tip: str) -> None:
    chain = ET.SubElement(ET.SubElement(root, "group", name=group), "chain")
    chain.set("base_link", base)
    chain.set("tip_link", tip)


def _add_joints(root: ET.Element, group: str, joints: Sequence[str]) -> None:
    element = ET.SubElement(root, "group", name=group)
    for joint in joints:
        ET.SubElement(element, "joint", name=joint)


def _add_home(root: ET.Element, group: str, robot: RobotDescription) -> None:
    state = ET.SubElement(root, "group_state", name="home", group=group)
    for joint, value in zip(robot.descriptor.joints, robot.descriptor.home, strict=True):
        ET.SubElement(state, "joint", name=joint, value=repr(value))


def _add_gripper(root: ET.Element, robot: RobotDescription, arm: str, name: str) -> None:
    gripper = robot.descriptor.grippers[name]
    joints = gripper.joints(robot.urdf)
    group = ET.SubElement(root, "group", name=name)
    for joint in joints:
        ET.SubElement(group, "joint", name=joint)
    for called, width in (("open", gripper.open), ("close", gripper.closed)):
        state = ET.SubElement(root, "group_state", name=called, group=name)
        for joint, (multiplier, offset) in joints.items():
            ET.SubElement(state, "joint", name=joint, value=repr(multiplier * gripper.position(width) + offset))
    palm = next(joint.parent for joint in robot.urdf.joint_of_child.values() if joint.name == gripper.joint)
    carrier = next((one for one in robot.descriptor.groups if _carries(robot, one, palm)), arm)
    ET.SubElement(root, "end_effector", name=name, parent_link=palm, group=name, parent_group=carrier)
    for joint in joints:
        if joint != gripper.joint:
            ET.SubElement(root, "passive_joint", name=joint)


def _carries(robot: RobotDescription, group: str, link: str) -> bool:
    """Whether the last joint of a group carries a link."""
    moving = [joint.name for joint in robot.urdf.chain(robot.descriptor.base_link, link) if joint.type != "fixed"]
    return moving[-1:] == [*robot.group_joints(group)[-1:]]


def _unchecked(robot: RobotDescription) -> Iterator[tuple[str, str, str]]:
    """Pairs of links and why: links beside each other, and those that the descriptor leaves out."""
    beside = {frozenset((joint.parent, joint.child)) for joint in robot.urdf.joint_of_child.values()}
    ignored = {frozenset(pair) for pair in robot.descriptor.self_collision_ignore}
    for one, other in itertools.combinations(robot.urdf.links, 2):
        pair = frozenset((one, other))
        if pair in beside:
            yield one, other, "Adjacent"
        elif pair in ignored:
            yield one, other, "Never"


def _urdf_name(robot: RobotDescription) -> str:
    """The name in the URDF, which the SRDF must have as well."""
    return ET.parse(robot.urdf_path).getroot().get("name") or robot.descriptor.name  # noqa: S314  a file of the robot's
