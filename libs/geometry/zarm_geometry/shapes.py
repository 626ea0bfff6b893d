"""The exact shapes of links and obstacles, and their distances by FCL."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import fcl
import numpy as np

from zarm_contract.collision import CollisionCuboid, CollisionCylinder, CollisionPrimitive, CollisionSphere
from zarm_geometry.frames import matrix, rotation_to
from zarm_trajectory.arrays import Array

_DISTANCE = fcl.DistanceRequest()
_IGNORED = fcl.DistanceResult(-math.inf)
"""FCL's bindings find nothing to improve here, so nearest points are not copied. Not for triangles, for which FCL
itself searches only for improvements.
"""
_TOUCHING = 1e-9
"""Shapes no further apart than this (m) overlap: FCL finds a distance of 1e-17 m between a ball and a triangle deep in
it.
"""


@dataclass(frozen=True)
class Shape:
    """One convex shape, centred in its frame `pose` (4, 4), which is given in a link's frame or in the base frame.

    It is all points within `rounding` of a box of half extents `core` (3,) that is widened by a disc of radius `disc`
    about z. So a cuboid is its core, a sphere a rounding, a capsule both, and a cylinder a segment with a disc. With a
    negative `disc` it is a triangle with its first corner in the origin, and `core` is as in `zarm_geometry.packed_shapes`.
    """

    name: str
    geometry: Any
    pose: Array
    core: Array
    disc: float
    rounding: float

    @property
    def half(self) -> Array:
        """Half extents (3,) of the box around it without the rounding."""
        half: Array = self.core + np.array([self.disc, self.disc, 0.0])
        return half

    @property
    def radius(self) -> float:
        """From the centre to the farthest point (m)."""
        return math.hypot(math.hypot(self.core[0], self.core[1]) + self.disc, self.core[2]) + self.rounding

    @property
    def corners(self) -> Array:
        """The corners of a triangle (3, 3), in its frame."""
        b, c, d = self.core
        return np.array([(0.0, 0.0, 0.0), (b, 0.0, 0.0), (c, d, 0.0)])

    def support(self, directions: Array) -> Array:
        """Support distances (n,): how far the shape extends from the origin of its frame along unit `directions` (n, 3)
        in it.
        """
        if self.disc < 0.0:
            far: Array = (directions @ self.corners.T).max(axis=1)
            return far
        reach: Array = np.abs(directions) @ self.core + self.disc * np.hypot(directions[:, 0], directions[:, 1])
        return reach + self.rounding


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


def obstacle_shape(name: str, row: Array) -> Shape:
    """One row (17,) of `World.rows`, made from a primitive of one of these kinds, in the base frame."""
    turn = row[:12].reshape(3, 4)
    back = turn[:, :3].T
    pose = np.zeros((4, 4))
    pose[:3, :3], pose[:3, 3], pose[3, 3] = back, -(back @ turn[:, 3]), 1.0
    x, y, z, disc, rounding = row[12:].tolist()
    if disc < 0.0:
        return _triangle(name, pose, (x, y, z))
    if disc > 0.0:
        return _cylinder(name, pose, disc, 2 * z)
    if x > 0.0:
        return _cuboid(name, pose, (2 * x, 2 * y, 2 * z))
    return _capsule(name, pose, rounding, 2 * z) if z > 0.0 else _ball(name, pose, rounding)


def distance(a: Shape, pose_a: Array, b: Shape, pose_b: Array, upper: float = math.inf) -> float:
    """The distance (m) of two shapes by FCL, at most `upper`; negative for a penetration depth. Poses (4, 4) in one
    frame.
    """
    measured: float = fcl.distance(
        fcl.CollisionObject(a.geometry, fcl.Transform(pose_a[:3, :3], pose_a[:3, 3])),
        fcl.CollisionObject(b.geometry, fcl.Transform(pose_b[:3, :3], pose_b[:3, 3])),
        _DISTANCE,
        fcl.DistanceResult() if min(a.disc, b.disc) < 0.0 else _IGNORED,
    )
    nearest = min(measured, upper)
    return nearest if nearest > _TOUCHING else -depth(a, pose_a, b, pose_b)


def nearest_points(a: Shape, pose_a: Array, b: Shape, pose_b: Array) -> Array | None:
    """The nearest points (2, 3) of two shapes by FCL, in the frame of the poses; None if they overlap."""
    found = fcl.DistanceResult()
    measured = fcl.distance(
        fcl.CollisionObject(a.geometry, fcl.Transform(pose_a[:3, :3], pose_a[:3, 3])),
        fcl.CollisionObject(b.geometry, fcl.Transform(pose_b[:3, :3], pose_b[:3, 3])),
        fcl.DistanceRequest(enable_nearest_points=True),
        found,
    )
    return np.array(found.nearest_points) if measured > _TOUCHING else None


def depth(a: Shape, pose_a: Array, b: Shape, pose_b: Array) -> float:
    """The least distance (m) by which one of two overlapping shapes must be moved to separate them; poses (4, 4) in one
    frame.

    If only their roundings overlap, that is the sum of the roundings minus the distance of the cores. Otherwise it is
    the smallest extent of their Minkowski difference over all directions: first many, then closer ones around the best.
    (FCL's own depth is off by up to 0.3 m for capsules, and if two centres coincide it may not return.)
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
        extents = (
            directions @ between + a.support(directions @ pose_a[:3, :3]) + b.support(-directions @ pose_b[:3, :3])
        )
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
    return Shape(name, fcl.Sphere(radius), pose, np.zeros(3), 0.0, radius)


def _cuboid(name: str, pose: Array, size: Sequence[float]) -> Shape:
    return Shape(name, fcl.Box(*size), pose, np.array(size) / 2, 0.0, 0.0)


def _capsule(name: str, pose: Array, radius: float, length: float) -> Shape:
    return Shape(name, fcl.Capsule(radius, length), pose, np.array([0.0, 0.0, length / 2]), 0.0, radius)


def _cylinder(name: str, pose: Array, radius: float, length: float) -> Shape:
    return Shape(name, fcl.Cylinder(radius, length), pose, np.array([0.0, 0.0, length / 2]), radius, 0.0)


def _triangle(name: str, pose: Array, core: Sequence[float]) -> Shape:
    # FCL's own triangle cannot be measured: it reports everything as free. A mesh of one triangle can.
    geometry = fcl.BVHModel()
    shape = Shape(name, geometry, pose, np.array(core), -1.0, 0.0)
    geometry.beginModel(1, 3)
    geometry.addSubModel(shape.corners, np.array([[0, 1, 2]]))
    geometry.endModel()
    return shape
