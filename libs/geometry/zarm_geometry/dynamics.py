"""How heavy a robot is, and the torques that its motions need.

With q'' the acceleration and q' the velocity, a motion needs the torque of the links by the recursive Newton-Euler algorithm, and at
each joint armature q'' + damping q' + friction sign(q').
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from zarm_contract.descriptor import StatedJointDynamics
from zarm_contract.messages import Attached, Capsule, Cuboid, Cylinder, Mesh, SceneObject, Sphere, Voxels
from zarm_contract.robot import RobotDescription
from zarm_contract.urdf import Inertial
from zarm_geometry.body import along
from zarm_geometry.frames import matrix, of_rpy
from zarm_geometry.inertia import usable_inertials
from zarm_geometry.joint_tree import JointTree, Place
from zarm_geometry.kernels.dynamics import torques
from zarm_trajectory.arrays import Array, Indices


class Weight(NamedTuple):
    """A body that a joint carries, -1 for the base: its `mass` (kg), its `center` (3,) and its `inertia` (3, 3) about that, in
    the joint's frame.
    """

    joint: int
    mass: float
    center: Array
    inertia: Array

    @classmethod
    def of(cls, inertial: Inertial, place: Place) -> Self:
        """The inertial of a link at `place`."""
        joint, pose = place
        turn = pose[:3, :3] @ of_rpy(inertial.rpy)
        xx, yy, zz, xy, xz, yz = inertial.inertia
        inertia = turn @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ turn.T
        return cls(joint, inertial.mass, pose[:3, :3] @ inertial.xyz + pose[:3, 3], inertia)


def weights_of_load(item: Attached, mass: float, place: Place) -> Iterator[Weight]:
    """An attached object of some `mass` (kg), spread evenly, at `place`, the frame of its link; of a mesh or voxels, its parts. Where it states
    its center, all of it is moved so that its centre of mass is there.
    """
    joint, pose = place
    parts = item.parts or ((item.object,) if not isinstance(item.object, Mesh | Voxels) else ())
    volumes = np.array([_solid(part)[0] for part in parts])
    masses = mass * volumes / volumes.sum()
    frames = [pose @ _placed(part) for part in parts]
    moved = np.zeros(3)
    if item.center is not None:
        center: Array = (pose @ _placed(item.object) @ (*item.center, 1.0))[:3]
        moved = center - np.average([frame[:3, 3] for frame in frames], axis=0, weights=masses)
    for part, share, frame in zip(parts, masses.tolist(), frames, strict=True):
        inertia = frame[:3, :3] @ np.diag(share * _solid(part)[1]) @ frame[:3, :3].T
        yield Weight(joint, share, frame[:3, 3] + moved, inertia)


def _placed(item: SceneObject) -> Array:
    """The pose (4, 4) of an object."""
    return matrix(item.position) if isinstance(item, Sphere) else matrix(item.position, item.orientation)


def _solid(part: Cuboid | Sphere | Capsule | Cylinder) -> tuple[float, Array]:
    """The volume (m³) of a solid, and its moments of inertia (3,) by its mass; a capsule counts as the cylinder around it."""
    if isinstance(part, Cuboid):
        x, y, z = part.size
        return x * y * z, np.array([y * y + z * z, x * x + z * z, x * x + y * y]) / 12.0
    square = part.radius**2
    if isinstance(part, Sphere):
        return 4.0 / 3.0 * np.pi * part.radius**3, np.full(3, 0.4 * square)
    length = part.length + (2.0 * part.radius if isinstance(part, Capsule) else 0.0)
    across = square / 4.0 + length**2 / 12.0
    return np.pi * square * length, np.array([across, across, square / 2.0])


def weights_of(robot: RobotDescription) -> tuple[Weight, ...] | None:
    """What the links of a robot weigh, its grippers open; None if one that moves states no inertia that can be used."""
    descriptor, joints = robot.descriptor, robot.descriptor.joints
    inertials, grippers = usable_inertials(robot)[0], robot.gripper_positions({})
    weights = []
    for link in {*descriptor.collision, *inertials}:
        passed, pose = along(robot.urdf.chain(descriptor.base_link, link), grippers)
        if passed and link not in inertials:
            return None
        if passed:
            weights.append(Weight.of(inertials[link], (joints.index(passed[-1][0]), pose)))
    return tuple(weights)


def weights_of_payloads(robot: RobotDescription) -> Iterator[Weight]:
    """What is mounted on the links of a robot, as points; what stands on its base weighs nothing."""
    descriptor, grippers = robot.descriptor, robot.gripper_positions({})
    for link, payload in descriptor.payloads.items():
        passed, pose = along(robot.urdf.chain(descriptor.base_link, link), grippers)
        if passed:
            center = pose[:3, :3] @ payload.center + pose[:3, 3]
            yield Weight(descriptor.joints.index(passed[-1][0]), payload.mass, center, np.zeros((3, 3)))


class JointDynamics(NamedTuple):
    """Coulomb `friction` (dof,) in Nm, `damping` (dof,) in Nm s/rad, and `armature` (dof,) in kg m²; N, N s/m and kg if prismatic."""

    friction: Array
    damping: Array
    armature: Array

    @classmethod
    def of(cls, stated: StatedJointDynamics) -> Self:
        """What a descriptor states."""
        return cls(np.array(stated.friction), np.array(stated.damping), np.array(stated.armature))

    def torque(self, direction: Array, velocity: Array, acceleration: Array) -> Array:
        """The torques (n, dof) of joints that move in a `direction` (n, dof) from -1 to 1, with velocity and acceleration (n, dof)."""
        needed: Array = self.friction * direction + self.damping * velocity + self.armature * acceleration
        return needed


@dataclass(frozen=True)
class Dynamics:
    """The tree of a robot's joints with what each carries, see `kernels.dynamics.torques`, and the largest torques `limit` (dof,):
    Nm, N if prismatic, infinite where it is unknown; and what is known of the `joints`.
    """

    tree: JointTree
    mass: Array
    center: Array
    inertia: Array
    limit: Array
    joints: JointDynamics | None = None

    @classmethod
    def of(cls, tree: JointTree, weights: Iterable[Weight], limit: Array, joints: JointDynamics | None = None) -> Self:
        """Join what is carried by the same joint."""
        dof = len(limit)
        parts: list[list[Weight]] = [[] for _ in range(dof)]
        for weight in weights:
            if weight.joint >= 0:
                parts[weight.joint].append(weight)
        mass, center, inertia = np.zeros(dof), np.zeros((dof, 3)), np.zeros((dof, 3, 3))
        for j, carried in enumerate(parts):
            mass[j] = sum(weight.mass for weight in carried)
            if mass[j] > 0.0:
                center[j] = sum(weight.mass * weight.center for weight in carried) / mass[j]
            for weight in carried:
                away = weight.center - center[j]
                inertia[j] += weight.inertia + weight.mass * (away @ away * np.eye(3) - np.outer(away, away))
        return cls(tree, mass, center, inertia, limit, joints)

    def torque(self, position: ArrayLike, velocity: ArrayLike, acceleration: ArrayLike) -> Array:
        """The torques (n, dof) of a motion (n, dof) in rad, rad/s and rad/s²."""
        q, v, a = self._positions(position), self._rates(velocity), self._rates(acceleration)
        out = np.empty_like(q)
        tree = self.tree
        torques(tree.table, tree.origin, self.mass, self.center, self.inertia, q, v, a, out)
        return out if self.joints is None else out + self.joints.torque(np.sign(v), v, a)

    def holding(self, position: ArrayLike) -> Array:
        """The torques (n, dof) that hold the robot still at `position` (n, dof)."""
        still = np.zeros_like(np.asarray(position, dtype=float))
        return self.torque(position, still, still)

    def resistance(self, velocity: ArrayLike) -> Array:
        """The torques (n, dof) of friction and damping at `velocity` (n, dof)."""
        v = self._rates(velocity)
        return np.zeros_like(v) if self.joints is None else self.joints.torque(np.sign(v), v, np.zeros_like(v))

    def of_links(self) -> Self:
        """The torques that the links need, without the friction and the armature of the joints."""
        return replace(self, joints=None)

    def _positions(self, given: ArrayLike) -> Array:
        """Positions (n, dof) of all joints."""
        return np.ascontiguousarray(given, dtype=float)

    def _rates(self, given: ArrayLike) -> Array:
        """Velocities or accelerations (n, dof) of all joints."""
        return np.ascontiguousarray(given, dtype=float)

    def of_group(self, joints: Indices, standing: Array) -> GroupDynamics:
        """Those of motions of some `joints` (n,), while the others stand as in `standing` (dof,)."""
        return GroupDynamics(
            self.tree, self.mass, self.center, self.inertia, self.limit, self.joints, moving=joints, standing=standing
        )


@dataclass(frozen=True)
class GroupDynamics(Dynamics):
    """The torques of all joints, (n, dof), in motions (n, len(moving)) of some joints `moving`, while the others stand as in `standing` (dof,) and hold what moves."""

    moving: Indices = field(kw_only=True)
    standing: Array = field(kw_only=True)

    def _positions(self, given: ArrayLike) -> Array:
        return self._whole(given, self.standing)

    def _rates(self, given: ArrayLike) -> Array:
        return self._whole(given, np.zeros_like(self.standing))

    def _whole(self, given: ArrayLike, at_rest: Array) -> Array:
        rows = np.asarray(given, dtype=float)
        columns: Array = np.tile(at_rest, (len(rows), 1))
        columns[:, self.moving] = rows
        return columns
