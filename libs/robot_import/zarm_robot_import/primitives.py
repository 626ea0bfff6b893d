"""Convex primitives, as the descriptor has them, as rows of `zarm_geometry.packed_shapes`, and as triangles."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from zarm_contract.collision import (
    CollisionCapsule,
    CollisionCuboid,
    CollisionCylinder,
    CollisionPrimitive,
    CollisionSphere,
)
from zarm_geometry.shapes import link_shape
from zarm_robot_import.kernels.outside import within
from zarm_trajectory.arrays import Array


def written(row: Array) -> CollisionPrimitive:
    """A row (17,) of `zarm_geometry.packed_shapes` in the descriptor's form."""
    frame = row[:12].reshape(3, 4)
    turn = frame[:, :3].T
    middle = -turn @ frame[:, 3]
    core, disc, rounding = row[12:15], round(float(row[15]), 7), round(float(row[16]), 7)
    if not disc and not rounding:
        x, y, z, w = np.round(Rotation.from_matrix(turn).as_quat(canonical=True), 9).tolist()
        return CollisionCuboid(
            kind="cuboid", center=_numbers(middle), orientation=(x, y, z, w), size=_numbers(2 * core)
        )
    if not core[2]:
        return CollisionSphere(center=_numbers(middle), radius=rounding)
    a, b = (_numbers(middle + end * core[2] * turn[:, 2]) for end in (-1.0, 1.0))
    if disc:
        return CollisionCylinder(kind="cylinder", a=a, b=b, radius=disc)
    return CollisionCapsule(kind="capsule", a=a, b=b, radius=rounding)


def packed_shapes_of(primitives: Sequence[CollisionPrimitive]) -> Array:
    """The primitives of a link as rows (n, 17) in its frame, see `zarm_geometry.packed_shapes`."""
    found = []
    for shape in (link_shape("", primitive) for primitive in primitives):
        turn = shape.pose[:3, :3].T
        frame = np.column_stack((turn, -turn @ shape.pose[:3, 3]))
        found.append(np.concatenate([frame.ravel(), shape.core, [shape.disc, shape.rounding]]))
    return np.array(found).reshape(-1, 17)


def triangles_of(row: Array) -> Array:
    """The surface (n, 3, 3) of a primitive (17,), in its link's frame, to 1 % of its radius."""
    core, disc, rounding = row[12:15], row[15], row[16]
    if disc:
        placed = _cylinder() * (disc, disc, core[2])
    elif rounding:
        placed = _capsule() * rounding
        placed[..., 2] += np.where(placed[..., 2] > 0.0, core[2] - rounding, rounding - core[2])
    else:
        placed = _box() * core
    frame = row[:12].reshape(3, 4)
    found: Array = (placed - frame[:, 3]) @ frame[:, :3]
    return found


@cache
def _cylinder() -> Array:
    """The surface (n, 3, 3) of a cylinder of radius 1 and length 2."""
    return np.array(trimesh.creation.cylinder(1.0, 2.0, sections=48).triangles)


@cache
def _capsule() -> Array:
    """The surface (n, 3, 3) of a capsule of radius 1 whose ends are 2 apart."""
    mesh = trimesh.creation.capsule(2.0, 1.0, count=[24, 24])
    return np.array(mesh.triangles - mesh.bounds.mean(axis=0))


@cache
def _box() -> Array:
    """The surface (n, 3, 3) of a cube of size 2."""
    return np.array(trimesh.creation.box((2.0, 2.0, 2.0)).triangles)


def grown(row: Array, by: float) -> Array:
    """A primitive (17,) that contains all points within `by` (m) of one without triangles."""
    row = row.copy()
    if row[16]:
        row[16] += by
    elif row[15]:
        row[14:16] += by
    else:
        row[12:15] += by
    return row


def below(points: Array, rows: Array) -> NDArray[np.bool_]:
    """Which points (n, 3) are more than 1 um below the surface of one of the shapes (m, 17)."""
    return within(points, np.array([grown(row, -1e-6) for row in rows]).reshape(-1, 17), 0.0)


def volumes(rows: Array) -> Array:
    """Volumes (n,) in m^3."""
    x, y, z, disc, rounding = rows[:, 12:].T
    found: Array = 8 * x * y * z + math.pi * (2 * disc**2 * z + rounding**2 * (2 * z + 4 / 3 * rounding))
    return found


def _numbers(values: Array) -> tuple[float, float, float]:
    x, y, z = (np.round(values, 7) + 0.0).tolist()
    return x, y, z
