"""The sphere model again, in plain numpy and float64, as the reference for the compiled kernels."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from zarm_contract.messages import Capsule, Cuboid, Cylinder, SceneObject, Sphere
from zarm_geometry.frames import matrix
from zarm_geometry.robot_model import RobotModel
from zarm_trajectory.arrays import Array


def random_object(kind: str, name: str, center: Array, size: float, rng: np.random.Generator) -> SceneObject:
    """An object of about `size` m, turned at random."""
    turn = rng.normal(size=4)
    x, y, z, w = (turn / np.linalg.norm(turn)).tolist()
    a, b, c = (size * rng.uniform(0.3, 1.0, 3)).tolist()
    position = (float(center[0]), float(center[1]), float(center[2]))
    if kind == "sphere":
        return Sphere(kind="sphere", name=name, position=position, radius=a / 2)
    if kind == "cuboid":
        return Cuboid(kind="cuboid", name=name, position=position, orientation=(x, y, z, w), size=(a, b, c))
    if kind == "capsule":
        return Capsule(kind="capsule", name=name, position=position, orientation=(x, y, z, w), radius=a / 3, length=b)
    return Cylinder(kind="cylinder", name=name, position=position, orientation=(x, y, z, w), radius=a / 2, length=b)


def random_objects(count: int, size: float, rng: np.random.Generator, farthest: float = 1.2) -> tuple[SceneObject, ...]:
    """Objects of all kinds, from 0.35 m to `farthest` away from the base."""
    kinds = itertools.cycle(("cuboid", "sphere", "capsule", "cylinder"))
    directions = rng.normal(size=(count, 3))
    centers = directions / np.linalg.norm(directions, axis=1, keepdims=True) * rng.uniform(0.35, farthest, (count, 1))
    return tuple(random_object(next(kinds), f"thing{i}", center, size, rng) for i, center in enumerate(centers))


def random_joints(model: RobotModel, count: int, rng: np.random.Generator) -> Array:
    """Configurations (count, dof) within the limits, those of continuous joints within a turn."""
    return rng.uniform(*model.range_about(np.zeros(model.dof)), (count, model.dof))


def distance(item: SceneObject, points: Array) -> Array:
    """Distance (...) of points (..., 3) to an object, 0 inside: to the nearest point of it, found in its own frame."""
    orientation = (0.0, 0.0, 0.0, 1.0) if isinstance(item, Sphere) else item.orientation
    pose = matrix(item.position, orientation)
    local = (points - pose[:3, 3]) @ pose[:3, :3]
    nearest = np.zeros_like(local)
    rounding = 0.0
    if isinstance(item, Cuboid):
        half = np.array(item.size) / 2
        nearest = np.clip(local, -half, half)
    elif isinstance(item, Cylinder):
        across = np.linalg.norm(local[..., :2], axis=-1, keepdims=True)
        nearest[..., :2] = local[..., :2] * np.minimum(1.0, item.radius / np.maximum(across, 1e-12))
        nearest[..., 2] = np.clip(local[..., 2], -item.length / 2, item.length / 2)
    else:
        rounding = item.radius
        if isinstance(item, Capsule):
            nearest[..., 2] = np.clip(local[..., 2], -item.length / 2, item.length / 2)
    return np.asarray(np.maximum(np.linalg.norm(local - nearest, axis=-1) - rounding, 0.0))


def spheres(model: RobotModel, joints: Array) -> list[tuple[Array, Array]]:
    """For each link the centres (n, m, 3) and radii (m,) of its spheres, for configurations (n, dof)."""
    balls = [model.robot.descriptor.spheres[name] for name in model.links]
    centers = [np.array([[*ball.center, 1.0] for ball in link]) for link in balls]
    poses = np.moveaxis(model.link_transforms(joints), 1, 0)
    return [
        (center @ np.swapaxes(pose[:, :3], 1, 2), np.array([ball.radius for ball in link]))
        for pose, center, link in zip(poses, centers, balls, strict=True)
    ]


def gaps_to_objects(model: RobotModel, objects: Sequence[SceneObject], joints: Array) -> Array:
    """Smallest gap (n,) of any sphere to an object, for configurations (n, dof). Links on the base do not count.

    Correct as long as no sphere's centre is inside an object.
    """
    gaps = [np.full(len(joints), np.inf)]
    for joint, (centers, radii) in zip(model.link_joint, spheres(model, joints), strict=True):
        if joint >= 0:
            gaps += [(distance(item, centers) - radii).min(axis=1) for item in objects]
    return np.asarray(np.min(gaps, axis=0))


def gaps_to_itself(model: RobotModel, joints: Array) -> Array:
    """Smallest gap (n,) between spheres of links that may collide, for configurations (n, dof)."""
    ignored = {frozenset(pair) for pair in model.robot.descriptor.self_collision_ignore}
    gaps = [np.full(len(joints), np.inf)]
    links = list(zip(model.links, model.link_joint, spheres(model, joints), strict=True))
    for (a, joint_a, (centers_a, radii_a)), (b, joint_b, (centers_b, radii_b)) in itertools.combinations(links, 2):
        if joint_a != joint_b and frozenset((a, b)) not in ignored:
            apart = np.linalg.norm(centers_a[:, :, None] - centers_b[:, None], axis=-1)
            gaps.append((apart - radii_a[:, None] - radii_b).min(axis=(1, 2)))
    return np.asarray(np.min(gaps, axis=0))


def clearances(model: RobotModel, objects: Sequence[SceneObject], joints: Array) -> Array:
    """Smallest gap (n,) of any sphere to an object or to another link, for configurations (n, dof)."""
    return np.minimum(gaps_to_objects(model, objects, joints), gaps_to_itself(model, joints))
