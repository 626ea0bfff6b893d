"""Rigid parts of the robot and where they are fixed: links of the descriptor, and attached objects."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from zarm_contract.messages import Attached, Mesh, Sphere, Vector3, Voxels
from zarm_contract.robot import RobotDescription
from zarm_contract.urdf import Joint
from zarm_geometry.frames import matrix, of_rpy, rotation_to
from zarm_geometry.packed_shapes import primitives
from zarm_geometry.shapes import Shape, link_shape, obstacle_shape
from zarm_geometry.sphere_cover import MOST_BALLS, sphere_cover
from zarm_trajectory.arrays import Array


@dataclass(frozen=True)
class Body:
    """A rigid collision body: a link, or an attached object.

    It is fixed at `pose` (4, 4) to the moving joint `joint`, or to the base if that is -1. In its own frame `balls` (n,
    4), x, y, z and radius (m), cover its exact `shapes`. It may touch the bodies named in `touches`. `origin` (4, 4) is
    the frame of the link, or of the object, in that of the joint. `around` (4,) is a ball around all `balls`.
    """

    name: str
    joint: int
    pose: Array
    origin: Array
    balls: Array
    shapes: tuple[Shape, ...]
    touches: frozenset[str]
    around: Array

    @property
    def placed_balls(self) -> Array:
        """The balls (n, 4) in the joint's frame."""
        return self._placed(self.balls)

    @property
    def placed_around(self) -> Array:
        """The ball around all (4,) in the joint's frame."""
        around: Array = self._placed(self.around[None])[0]
        return around

    def carried(self, joint: int, frame: Array) -> Self:
        """The same body, carried by another joint, in whose frame the present one's is `frame` (4, 4)."""
        return replace(self, joint=joint, pose=frame @ self.pose, origin=frame @ self.origin)

    def _placed(self, balls: Array) -> Array:
        return np.column_stack((balls[:, :3] @ self.pose[:3, :3].T + self.pose[:3, 3], balls[:, 3]))


def link_body(robot: RobotDescription, link: str, grippers: Mapping[str, float]) -> Body:
    """A link of the descriptor as a body; it may touch the links paired with it in `self_collision_ignore`.

    `grippers` are the positions of the grippers' joints.
    """
    descriptor = robot.descriptor
    passed, pose = along(robot.urdf.chain(descriptor.base_link, link), grippers)
    beside = [set(pair) for pair in descriptor.self_collision_ignore if link in pair]
    balls = np.array([[*ball.center, ball.radius] for ball in descriptor.spheres[link]])
    return Body(
        name=link,
        joint=descriptor.joints.index(passed[-1][0]) if passed else -1,
        pose=pose,
        origin=pose,
        balls=balls,
        shapes=tuple(link_shape(link, item) for item in descriptor.collision[link]),
        touches=frozenset().union(*beside),
        around=bounding_ball(balls),
    )


def attached_body(item: Attached, joint: int, tip: Array) -> Body:
    """An attached object as a body, named as in the scene and fixed to the frame `tip` (4, 4) in that of a joint."""
    name = item.object.name
    parts = [item.object] if not isinstance(item.object, Mesh | Voxels) else item.parts
    shapes = tuple(obstacle_shape(name, row) for row in primitives(parts))
    balls = np.concatenate([sphere_cover(shape, max(2, MOST_BALLS // len(shapes))) for shape in shapes])
    placed = item.object
    origin = tip @ (
        matrix(placed.position) if isinstance(placed, Sphere) else matrix(placed.position, placed.orientation)
    )
    return Body(name, joint, tip, origin, balls, shapes, frozenset(item.touch_links), bounding_ball(balls))


def bounding_ball(balls: Array) -> Array:
    """A small ball (4,) around balls (n, 4): the centre moves towards the farthest one in decreasing steps.

    Badoiu and Clarkson, "Smaller core-sets for balls", 2003.
    """
    center = balls[:, :3].mean(axis=0)
    for step in range(1, 200):
        away = balls[:, :3] - center
        farthest = int(np.argmax(np.linalg.norm(away, axis=1) + balls[:, 3]))
        center = center + away[farthest] / (step + 1)
    radius = float(np.max(np.linalg.norm(balls[:, :3] - center, axis=1) + balls[:, 3]))
    return np.array([*center, radius])


def along(chain: Sequence[Joint], standing: Mapping[str, float]) -> tuple[list[tuple[str, Array]], Array]:
    """Along a chain: each moving joint with its frame in the previous one (3, 4), and the chain's end (4, 4) in the last.

    Joints in `standing` stand at these positions (rad, m), as fixed ones do. The frame of a moving joint is rotated so that its axis
    is z: the kernels need only one kind of rotation.
    """
    origins: list[tuple[str, Array]] = []
    pose = np.eye(4)
    for joint in chain:
        pose = pose @ _pose(joint)
        if joint.name in standing:
            pose = pose @ _moved(joint, standing[joint.name])
        elif joint.type != "fixed":
            turn = _turn(joint.axis)
            origins.append((joint.name, (pose @ turn)[:3]))
            pose = turn.T
    return origins, pose


def _turn(axis: Vector3) -> Array:
    """A rotation (4, 4) that takes z to `axis`."""
    turn = np.eye(4)
    turn[:3, :3] = rotation_to(axis)
    return turn


def _moved(joint: Joint, position: float) -> Array:
    """The motion (4, 4) of a joint at a position (rad, m)."""
    motion, turn = np.eye(4), _turn(joint.axis)
    if joint.type == "prismatic":
        motion[2, 3] = position
    else:
        (c, s) = (math.cos(position), math.sin(position))
        motion[:2, :2] = [[c, -s], [s, c]]
    return np.asarray(turn @ motion @ turn.T)


def _pose(joint: Joint) -> Array:
    """A joint's origin (4, 4) in its parent."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = of_rpy(joint.rpy), joint.xyz
    return pose
