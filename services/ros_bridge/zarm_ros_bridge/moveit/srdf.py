"""The semantic description of a robot, made from its descriptor."""

from __future__ import annotations

import itertools
import xml.etree.ElementTree as ET
from collections.abc import Iterator

from zarm_contract.robot import RobotDescription


def semantic_description(robot: RobotDescription, group: str) -> str:
    """The SRDF: the group of the arm with its named state `home`, one for each gripper with `open` and `close`, and the pairs of links
    that are not checked.
    """
    descriptor = robot.descriptor
    root = ET.Element("robot", name=_urdf_name(robot))
    chain = ET.SubElement(ET.SubElement(root, "group", name=group), "chain")
    chain.set("base_link", descriptor.base_link)
    chain.set("tip_link", descriptor.tip_link)
    state = ET.SubElement(root, "group_state", name="home", group=group)
    for joint, value in zip(descriptor.joints, descriptor.home, strict=True):
        ET.SubElement(state, "joint", name=joint, value=repr(value))
    for name in descriptor.grippers:
        _add_gripper(root, robot, group, name)
    for one, other, reason in _unchecked(robot):
        ET.SubElement(root, "disable_collisions", link1=one, link2=other, reason=reason)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode")


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
    ET.SubElement(root, "end_effector", name=name, parent_link=palm, group=name, parent_group=arm)
    for joint in joints:
        if joint != gripper.joint:
            ET.SubElement(root, "passive_joint", name=joint)


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
