"""A second opinion on planned motions: forward kinematics from the URDF and FCL's collision test, nothing of the
planner's.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any

import fcl
import numpy as np
from numpy.typing import ArrayLike

from zarm_contract.collision import CollisionCapsule, CollisionCuboid, CollisionPrimitive, CollisionSphere
from zarm_contract.messages import Attached, Cuboid, Cylinder, Quaternion, SceneObject, Sphere
from zarm_contract.robot import RobotDescription
from zarm_contract.urdf import Joint
from zarm_trajectory.arrays import Array


def link_pose(robot: RobotDescription, link: str, q: ArrayLike) -> Array:
    """The pose (4, 4) of any link in the base frame, with open grippers."""
    pose = np.eye(4)
    position = _positions(robot, q, {})
    for joint in robot.urdf.chain(robot.descriptor.base_link, link):
        pose = pose @ _origin(joint) @ _motion(joint, position.get(joint.name, 0.0))
    return pose


def tip_error(
    robot: RobotDescription, q: ArrayLike, position: Sequence[float], orientation: Quaternion
) -> tuple[float, float]:
    """The error of the tip pose: m and rad."""
    tip = link_pose(robot, robot.descriptor.tip_link, q)
    turn = tip[:3, :3].T @ _rotation(orientation)
    angle = math.acos(min(1.0, max(-1.0, (float(np.trace(turn)) - 1) / 2)))
    return float(np.linalg.norm(tip[:3, 3] - position)), angle


def _positions(robot: RobotDescription, q: ArrayLike, widths: Mapping[str, float]) -> dict[str, float]:
    """The position of each joint, also of those that move the fingers of a gripper: in proportion to its width."""
    positions = dict(zip(robot.descriptor.joints, np.asarray(q), strict=True))
    for name, gripper in robot.descriptor.grippers.items():
        at = float(np.interp(widths.get(name, gripper.widths[-1]), gripper.widths, gripper.positions))
        positions[gripper.joint] = at
        for joint in robot.urdf.joint_of_child.values():
            if joint.mimic is not None and joint.mimic[0] == gripper.joint:
                positions[joint.name] = joint.mimic[1] * at + joint.mimic[2]
    return positions


class _Posed:
    """The poses of a robot's links."""

    def __init__(self, robot: RobotDescription) -> None:
        self._robot = robot
        self._origins = {child: _origin(joint) for child, joint in robot.urdf.joint_of_child.items()}

    def _pose(self, link: str, position: dict[str, float], known: dict[str, Array]) -> Array:
        """As `link_pose`, using known poses of other links."""
        if link not in known:
            joint = self._robot.urdf.joint_of_child[link]
            parent = self._pose(joint.parent, position, known)
            known[link] = parent @ self._origins[link] @ _motion(joint, position.get(joint.name, 0.0))
        return known[link]


class Collisions(_Posed):
    """Whether the robot's exact geometry touches an object or itself, according to the descriptor and the scene.

    Pairs on the same rigid body are not checked. Grippers have these `widths`; those left out are open.
    """

    def __init__(
        self,
        robot: RobotDescription,
        objects: Sequence[SceneObject],
        attached: Sequence[Attached] = (),
        ignored_links: Sequence[str] = (),
        widths: Mapping[str, float] | None = None,
    ) -> None:
        self._widths = widths or {}
        descriptor = robot.descriptor
        super().__init__(robot)
        self._parts = {
            link: [(pose, fcl.CollisionObject(geometry)) for geometry, pose in map(_link_shape, items)]
            for link, items in descriptor.collision.items()
            if link not in ignored_links
        }
        self._frame = {name: name for name in self._parts}
        for one in attached:
            geometry, pose = _object_shape(one.object)
            self._parts[one.object.name] = [(pose, fcl.CollisionObject(geometry))]
            self._frame[one.object.name] = descriptor.tip_link
        self._managers = {name: _managed([shape for _, shape in shapes]) for name, shapes in self._parts.items()}
        self._objects = _managed([_placed(*_object_shape(item)) for item in objects])
        moving = set(descriptor.joints)
        passed = {
            name: [joint.name for joint in robot.urdf.chain(descriptor.base_link, frame) if joint.name in moving]
            for name, frame in self._frame.items()
        }
        self._movable = {name for name in self._parts if passed[name]}
        ignored = {frozenset(pair) for pair in descriptor.self_collision_ignore}
        ignored |= {frozenset((one.object.name, link)) for one in attached for link in one.touch_links}
        self._pairs = [
            (a, b)
            for a, b in itertools.combinations(self._parts, 2)
            if frozenset((a, b)) not in ignored and passed[a] != passed[b]
        ]

    def at(self, q: ArrayLike) -> bool:
        """Whether there is a collision at the configuration `q`."""
        poses = {self._robot.descriptor.base_link: np.eye(4)}
        position = _positions(self._robot, q, self._widths)
        for name, shapes in self._parts.items():
            frame = self._pose(self._frame[name], position, poses)
            for pose, shape in shapes:
                shape.setTransform(_transform(frame @ pose))
            self._managers[name].update()
        return any(_touch(self._managers[name], self._objects) for name in self._movable) or any(
            _touch(self._managers[a], self._managers[b]) for a, b in self._pairs
        )


def _managed(shapes: Sequence[fcl.CollisionObject]) -> fcl.DynamicAABBTreeCollisionManager:
    manager = fcl.DynamicAABBTreeCollisionManager()
    manager.registerObjects(shapes)
    manager.setup()
    return manager


def _touch(some: fcl.DynamicAABBTreeCollisionManager, others: fcl.DynamicAABBTreeCollisionManager) -> bool:
    found = fcl.CollisionData()
    some.collide(others, found, fcl.defaultCollisionCallback)
    return bool(found.result.is_collision)


def _link_shape(item: CollisionPrimitive) -> tuple[object, Array]:
    if isinstance(item, CollisionSphere):
        return fcl.Sphere(item.radius), _pose(np.eye(3), item.center)
    if isinstance(item, CollisionCuboid):
        return fcl.Box(*item.size), _pose(_rotation(item.orientation), item.center)
    a, b = np.array(item.a), np.array(item.b)
    length = float(np.linalg.norm(b - a))
    turn = _turn_z_to((b - a) / length) if length else np.eye(3)
    return (fcl.Capsule if isinstance(item, CollisionCapsule) else fcl.Cylinder)(item.radius, length), _pose(
        turn, (a + b) / 2
    )


def _object_shape(item: SceneObject) -> tuple[object, Array]:
    if isinstance(item, Sphere):
        return fcl.Sphere(item.radius), _pose(np.eye(3), item.position)
    pose = _pose(_rotation(item.orientation), item.position)
    if isinstance(item, Cuboid):
        return fcl.Box(*item.size), pose
    return (fcl.Cylinder if isinstance(item, Cylinder) else fcl.Capsule)(item.radius, item.length), pose


def _placed(geometry: object, pose: Array) -> fcl.CollisionObject:
    return fcl.CollisionObject(geometry, _transform(pose))


def _transform(pose: Array) -> fcl.Transform:
    return fcl.Transform(pose[:3, :3], pose[:3, 3])


def _pose(turn: Array, center: ArrayLike) -> Array:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, center
    return pose


def _origin(joint: Joint) -> Array:
    roll, pitch, yaw = joint.rpy
    pose = np.eye(4)
    pose[:3, :3] = _about((0, 0, 1), yaw) @ _about((0, 1, 0), pitch) @ _about((1, 0, 0), roll)
    pose[:3, 3] = joint.xyz
    return pose


def _motion(joint: Joint, q: float) -> Array:
    pose = np.eye(4)
    if joint.type == "prismatic":
        pose[:3, 3] = np.array(joint.axis) * q
    elif joint.type != "fixed":
        pose[:3, :3] = _about(joint.axis, q)
    return pose


def _about(axis: Sequence[float], angle: float) -> Array:
    """Rodrigues' formula."""
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    turn: Array = np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
    return turn


def _rotation(q: Quaternion) -> Array:
    angle = 2 * math.atan2(math.hypot(*q[:3]), q[3])
    return _about(q[:3], angle) if angle else np.eye(3)


def _turn_z_to(axis: Array) -> Array:
    across = np.cross((0.0, 0.0, 1.0), axis)
    if not across.any():
        return np.eye(3) if axis[2] > 0 else _about((1, 0, 0), math.pi)
    return _about(across, math.atan2(float(np.linalg.norm(across)), float(axis[2])))


_SPARE = 1e-3
"""More (m) than FCL's distances may be wrong."""


class Clearance(_Posed):
    """The distance of the robot's exact geometry to one object, which can be placed anywhere.

    Whatever is certainly further away than the nearest, by the balls around the shapes, FCL is not asked about.
    """

    def __init__(self, robot: RobotDescription, item: SceneObject) -> None:
        super().__init__(robot)
        parts = [
            (link, pose, geometry)
            for link, items in robot.descriptor.collision.items()
            for geometry, pose in map(_link_shape, items)
            if any(
                joint.name in robot.descriptor.joints for joint in robot.urdf.chain(robot.descriptor.base_link, link)
            )
        ]
        geometry, self._turned = _object_shape(item)
        self._object = fcl.CollisionObject(geometry)
        self._parts = [(pose, fcl.CollisionObject(shape)) for _, pose, shape in parts]
        self._links = sorted({link for link, _, _ in parts})
        self._of_link = np.array([self._links.index(link) for link, _, _ in parts])
        self._centers = np.array([pose[:, 3:] for _, pose, _ in parts])
        self._around = np.array([_radius(shape) for _, _, shape in parts]) + _radius(geometry) + _SPARE

    def at(self, q: ArrayLike, position: ArrayLike) -> float:
        """The distance (m) with the robot at `q` and the object at `position`; 0 or less if they touch."""
        place = self._turned.copy()
        place[:3, 3] = position
        self._object.setTransform(_transform(place))
        known = {self._robot.descriptor.base_link: np.eye(4)}
        values = _positions(self._robot, q, {})
        poses = np.array([self._pose(link, values, known) for link in self._links])[self._of_link]
        away = (poses @ self._centers)[:, :3, 0] - position
        bounds = np.sqrt((away * away).sum(axis=1)) - self._around
        least = np.inf
        for k in np.argsort(bounds).tolist():
            if bounds[k] > max(least, 0.0):
                break
            pose, shape = self._parts[k]
            shape.setTransform(_transform(poses[k] @ pose))
            least = min(least, fcl.distance(shape, self._object, fcl.DistanceRequest(), fcl.DistanceResult()))
        return float(least)


def _radius(geometry: Any) -> float:
    """Of a ball (m) around a shape at its own origin."""
    if isinstance(geometry, fcl.Box):
        return math.hypot(*geometry.side) / 2
    return float(geometry.radius + getattr(geometry, "lz", 0.0) / 2)
