"""The frames of a robot's links, from its URDF."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np

from zarm_contract.robot import RobotDescription
from zarm_contract.urdf import Joint
from zarm_geometry.frames import rotated_by
from zarm_trajectory.arrays import Array


class LinkFrames:
    """Forward kinematics of every link, also of those that the descriptor does not name.

    Joints that are not in the descriptor stand where `others` says, else at 0 or at the limit that is nearest to it; mimic joints
    follow theirs.
    """

    def __init__(self, robot: RobotDescription, others: Callable[[], Mapping[str, float]] = dict) -> None:
        self._others = others
        self.base = robot.descriptor.base_link
        self.links = robot.urdf.links
        self._joints = robot.descriptor.joints
        self._of_child = robot.urdf.joint_of_child
        self._origins = {child: _origin(joint) for child, joint in self._of_child.items()}

    def edges(self, position: Sequence[float]) -> Iterator[tuple[Joint, Array]]:
        """Each joint, and the pose (4, 4) of its child in the frame of its parent, at the `position` of the descriptor's joints."""
        values = {**self._others(), **dict(zip(self._joints, position, strict=True))}
        for child, joint in self._of_child.items():
            yield joint, self._origins[child] @ _motion(joint, self._value(joint, values))

    def poses(self, position: Sequence[float]) -> dict[str, Array]:
        """The pose (4, 4) of each link in the frame of the base link, at the `position` of the descriptor's joints."""
        edges = {joint.child: (joint.parent, pose) for joint, pose in self.edges(position)}
        in_root: dict[str, Array] = {}

        def pose_of(link: str) -> Array:
            if link not in in_root:
                parent, pose = edges.get(link, (None, np.eye(4)))
                in_root[link] = pose if parent is None else pose_of(parent) @ pose
            return in_root[link]

        root = np.linalg.inv(pose_of(self.base))
        return {link: root @ pose_of(link) for link in self.links}

    def rigid(self, link: str) -> str:
        """The first of the links that move with this one as one body: all of them have the same."""
        while (joint := self._of_child.get(link)) is not None and joint.type == "fixed":
            link = joint.parent
        return link

    def _value(self, joint: Joint, values: Mapping[str, float]) -> float:
        if joint.mimic is not None:
            name, multiplier, offset = joint.mimic
            leader = next((one for one in self._of_child.values() if one.name == name), None)
            return offset + multiplier * (0.0 if leader is None else self._value(leader, values))
        if joint.name in values:
            return values[joint.name]
        return min(max(0.0, joint.lower or 0.0), np.inf if joint.upper is None else joint.upper)


def _origin(joint: Joint) -> Array:
    """The frame of a joint at 0 in that of its parent: `xyz`, and Rz(yaw) Ry(pitch) Rx(roll)."""
    roll, pitch, yaw = np.diag(joint.rpy)
    x, y, z = rotated_by(np.array([roll, pitch, yaw]))
    pose = np.eye(4)
    pose[:3, :3] = z @ y @ x
    pose[:3, 3] = joint.xyz
    return pose


def _motion(joint: Joint, value: float) -> Array:
    pose = np.eye(4)
    axis = np.array(joint.axis)
    if joint.type == "prismatic":
        pose[:3, 3] = value * axis
    elif joint.type in ("revolute", "continuous"):
        pose[:3, :3] = rotated_by(value * axis[None])[0]
    return pose
