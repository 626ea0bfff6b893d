"""The tree of a robot's joints: which joint carries which, and where."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from zarm_contract.robot import RobotDescription
from zarm_geometry.body import along
from zarm_trajectory.arrays import Array, Index

Place = tuple[int, Array]
"""The joint that carries a frame, -1 for the base, and the frame (4, 4) in that joint's."""


@dataclass(frozen=True)
class JointTree:
    """The joints of a robot, each after the one that carries it.

    `parent` (dof,) is the joint that carries each joint, -1 for the base, and `origin` (dof, 3, 4) the joint's frame in
    that one's at 0, with the joint's axis along z. `revolute` (dof,): False for a joint that slides.
    """

    parent: Index
    origin: Array
    revolute: NDArray[np.bool_]

    @classmethod
    def of(cls, robot: RobotDescription) -> Self:
        """The tree of all joints of the descriptor."""
        joints, urdf = robot.descriptor.joints, robot.urdf
        links = {joint.name: (link, joint.type) for link, joint in urdf.joint_of_child.items()}
        parent, origin = [], []
        for joint in joints:
            passed, _ = along(urdf.chain(robot.descriptor.base_link, links[joint][0]), {})
            parent.append(joints.index(passed[-2][0]) if len(passed) > 1 else -1)
            origin.append(passed[-1][1])
        revolute = np.array([links[joint][1] != "prismatic" for joint in joints])
        return cls(np.array(parent, np.int32), np.array(origin), revolute)

    @cached_property
    def table(self) -> Index:
        """The tree (dof, 2) as `kernels.kinematics.joint_frames` takes it."""
        return np.column_stack([self.parent, self.revolute]).astype(np.int32)

    def ancestors(self, joint: int) -> list[int]:
        """A joint and those that carry it, inwards; none for the base (-1)."""
        found = []
        while joint >= 0:
            found.append(joint)
            joint = int(self.parent[joint])
        return found

    def common(self, link_joint: Index, pairs: Index) -> Index:
        """The last joint (m,) that moves both links of each pair (m, 2), -1 for the base; `link_joint` (links,) carry
        the links.
        """
        inwards = [self.ancestors(joint) for joint in link_joint.tolist()]
        shared = ([joint for joint in inwards[one] if joint in inwards[other]] for one, other in pairs.tolist())
        return np.array([max(joints, default=-1) for joints in shared], np.int32)

    def standing(self, moving: list[int], frames: Array) -> tuple[Self, list[Place]]:
        """The tree of the `moving` joints alone, and the place of each joint's frame in it.

        The others stand where they are with all joint frames at `frames` (dof, 4, 4), in the base frame.
        """
        places: list[Place] = []
        for joint in range(len(self.parent)):
            carrier = next((one for one in self.ancestors(joint) if one in moving), -1)
            frame = frames[joint] if carrier < 0 else np.linalg.inv(frames[carrier]) @ frames[joint]
            places.append((moving.index(carrier) if carrier >= 0 else -1, frame))
        parent, origin = [], []
        for joint in moving:
            carrier, frame = (-1, np.eye(4)) if self.parent[joint] < 0 else places[self.parent[joint]]
            parent.append(carrier)
            origin.append(frame[:3, :3] @ self.origin[joint])
            origin[-1][:, 3] += frame[:3, 3]
        tree = type(self)(np.array(parent, np.int32), np.array(origin), self.revolute[moving])
        return tree, places
