"""The exact shapes of robot links and scene objects: for FCL, and as bounds that numpy handles many at a time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import fcl
import numpy as np
from numpy.typing import NDArray

from zarm_contract.messages import Cuboid, Cylinder, SceneObject, Sphere
from zarm_contract.robot import CollisionCuboid, CollisionCylinder, CollisionPrimitive, CollisionSphere
from zarm_planner.frames import matrix, rotation_to

Array = NDArray[np.float64]

_BALLS = 6
"""At most so many balls cover one shape."""


@dataclass(frozen=True)
class Shape:
    """One convex shape, centred in its frame `pose` (4, 4), which is given in a link's frame or in the base frame.

    It is all points within `rounding` of a box of half extents `core` (3,) that is widened by a disc of radius `disc`
    about z. So a cuboid is its core, a sphere a rounding, a capsule both, and a cylinder a segment with a disc. It lies
    within `across` of a straight line along `axis`, its longest.
    """

    name: str
    geometry: Any
    pose: Array
    core: Array
    disc: float
    rounding: float
    axis: int
    across: float

    @property
    def half(self) -> Array:
        """Half extents (3,) of the box that, grown by the rounding, bounds the shape."""
        half: Array = self.core + np.array([self.disc, self.disc, 0.0])
        return half

    def support(self, directions: Array) -> Array:
        """How far (n,) the shape reaches from its centre along unit `directions` (n, 3) in its frame."""
        reach: Array = np.abs(directions) @ self.core + self.disc * np.hypot(directions[:, 0], directions[:, 1])
        return reach + self.rounding

    def balls(self) -> tuple[Array, float]:
        """Centres (n, 3) in the shape's frame and the radius of balls that cover it, in a row along its axis."""
        if not self.half.any():
            return np.zeros((1, 3)), self.rounding
        length = self.half[self.axis] + self.rounding
        count = min(_BALLS, math.ceil(2 * length / self.across))
        centers = np.zeros((count, 3))
        centers[:, self.axis] = length / count * (2 * np.arange(count) + 1 - count)
        return centers, math.hypot(self.across, length / count)


def link_shape(link: str, primitive: CollisionPrimitive) -> Shape:
    """A primitive of the robot descriptor, in its link's frame."""
    if isinstance(primitive, CollisionSphere):
        return _ball(link, matrix(primitive.center), primitive.radius)
    if isinstance(primitive, CollisionCuboid):
        return _cuboid(link, matrix(primitive.center, primitive.orientation), primitive.size)
    a, b = np.array(primitive.a), np.array(primitive.b)
    length = float(np.linalg.norm(b - a))
    pose = np.eye(4)
    pose[:3, 3] = (a + b) / 2
    if length > 0.0:
        pose[:3, :3] = rotation_to(b - a)
    make = _cylinder if isinstance(primitive, CollisionCylinder) else _capsule
    return make(link, pose, primitive.radius, length)


def object_shape(item: SceneObject) -> Shape:
    """A scene object, in the base frame."""
    if isinstance(item, Sphere):
        return _ball(item.name, matrix(item.position), item.radius)
    pose = matrix(item.position, item.orientation)
    if isinstance(item, Cuboid):
        return _cuboid(item.name, pose, item.size)
    make = _cylinder if isinstance(item, Cylinder) else _capsule
    return make(item.name, pose, item.radius, item.length)


def depth(a: Shape, pose_a: Array, b: Shape, pose_b: Array) -> float:
    """How far (m) one of two shapes that overlap must at least be moved to part them; poses (4, 4) in one frame.

    Where only their roundings overlap, that is what their cores lack of them. Otherwise it is the smallest extent of their
    Minkowski difference over all directions: of many, and then of ever closer ones around the best. (FCL's own depth is off
    by up to 0.3 m for capsules, and where two centres coincide it may not return.)
    """
    if a.rounding or b.rounding:
        cores = fcl.distance(*(_placed_core(shape, pose) for shape, pose in ((a, pose_a), (b, pose_b))))
        if cores > 0.0:
            return max(0.0, a.rounding + b.rounding - float(cores))
    between = pose_a[:3, 3] - pose_b[:3, 3]
    axes = np.concatenate([pose_a[:3, :3].T, pose_b[:3, :3].T])
    directions = np.concatenate([axes, -axes, _SPHERE])
    width = 0.2
    while True:
        extents = directions @ between + a.support(directions @ pose_a[:3, :3]) + b.support(directions @ pose_b[:3, :3])
        if width < 1e-4:
            return float(extents.min())
        best = directions[int(np.argmin(extents))]
        directions = np.concatenate([[best], best + width * _SPHERE[::4]])
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        width *= 0.5


def _placed_core(shape: Shape, pose: Array) -> fcl.CollisionObject:
    """A shape without its rounding."""
    geometry = fcl.Capsule(1e-9, 2 * shape.core[2]) if shape.rounding else shape.geometry
    return fcl.CollisionObject(geometry, fcl.Transform(pose[:3, :3], pose[:3, 3]))


def _sphere(count: int) -> Array:
    """Directions (count, 3) spread evenly, along a Fibonacci spiral."""
    z = 1 - (2 * np.arange(count) + 1) / count
    turn = np.pi * (3 - math.sqrt(5)) * np.arange(count)
    around = np.sqrt(1 - z * z)
    return np.column_stack((around * np.cos(turn), around * np.sin(turn), z))


_SPHERE = _sphere(256)


def _ball(name: str, pose: Array, radius: float) -> Shape:
    return Shape(name, fcl.Sphere(radius), pose, np.zeros(3), 0.0, radius, axis=0, across=radius)


def _cuboid(name: str, pose: Array, size: Sequence[float]) -> Shape:
    half = np.array(size) / 2
    axis = int(np.argmax(half))
    return Shape(name, fcl.Box(*size), pose, half, 0.0, 0.0, axis, across=math.hypot(*np.delete(half, axis)))


def _capsule(name: str, pose: Array, radius: float, length: float) -> Shape:
    core = np.array([0.0, 0.0, length / 2])
    return Shape(name, fcl.Capsule(radius, length), pose, core, 0.0, radius, axis=2, across=radius)


def _cylinder(name: str, pose: Array, radius: float, length: float) -> Shape:
    core = np.array([0.0, 0.0, length / 2])
    axis, across = (2, radius) if length > 2 * radius else (0, math.hypot(radius, length / 2))
    return Shape(name, fcl.Cylinder(radius, length), pose, core, radius, 0.0, axis, across)
