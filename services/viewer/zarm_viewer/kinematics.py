"""Forward kinematics of the tip, computed here because the tip is drawn many times a second."""

from __future__ import annotations

import numpy as np
from viser import SceneNodeHandle
from viser.transforms import SE3, SO3

from zarm_contract.messages import Pose
from zarm_contract.robot import RobotDescription
from zarm_contract.urdf import Joint
from zarm_trajectory.arrays import Array


def origin(joint: Joint) -> SE3:
    """The frame of a joint at its zero position, in the frame of its parent link."""
    return SE3.from_rotation_and_translation(SO3.from_rpy_radians(*joint.rpy), np.array(joint.xyz))


def motion(joint: Joint, value: float) -> SE3:
    """The motion of a joint's child link from there at `value` (rad, or m if prismatic)."""
    axis = np.array(joint.axis) / np.linalg.norm(joint.axis)
    if joint.type == "prismatic":
        return SE3.from_translation(axis * value)
    return SE3.from_rotation(SO3.exp(axis * value))


class Chain:
    """The joints from the base of a robot to its tip, or to that of a group."""

    def __init__(self, robot: RobotDescription, group: str | None = None) -> None:
        names = robot.descriptor.joints
        self._links = [
            (origin(joint), joint, names.index(joint.name) if joint.name in names else None)
            for joint in robot.urdf.chain(robot.descriptor.base_link, robot.tip_of((group,) if group else ()))
        ]

    def tip(self, joints: Array) -> SE3:
        """The tip's pose in the base frame at joint positions (J,) in rad."""
        pose = SE3.identity()
        for at, joint, index in self._links:
            pose = pose @ at if index is None else pose @ at @ motion(joint, float(joints[index]))
        return pose


def message_of(pose: SE3) -> Pose:
    """A pose in its message form, quaternion (x, y, z, w)."""
    w, x, y, z = pose.rotation().wxyz.tolist()
    px, py, pz = pose.translation().tolist()
    return Pose(position=(px, py, pz), orientation=(x, y, z, w))


def pose_at(handle: SceneNodeHandle) -> SE3:
    """The pose of a scene node in the frame of its parent."""
    return SE3.from_rotation_and_translation(SO3(np.array(handle.wxyz)), np.array(handle.position))


def pose_of(position: tuple[float, ...], orientation: tuple[float, ...]) -> SE3:
    """A pose from its message form: position in m, quaternion (x, y, z, w)."""
    x, y, z, w = orientation
    return SE3.from_rotation_and_translation(SO3(np.array([w, x, y, z])), np.array(position))
