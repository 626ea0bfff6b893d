"""Shapes of descriptors and scenes as geoms of MuJoCo."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import mujoco
import numpy as np

from zarm_contract.collision import CollisionPrimitive
from zarm_contract.messages import Quaternion, SceneObject, Vector3

_TYPES = {
    "cuboid": mujoco.mjtGeom.mjGEOM_BOX,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
}


def wxyz(orientation: Quaternion) -> list[float]:
    """A quaternion `[x, y, z, w]` in MuJoCo's order."""
    x, y, z, w = orientation
    return [w, x, y, z]


def of_rpy(rpy: Sequence[float]) -> list[float]:
    """Roll, pitch and yaw of a URDF (rad) as a quaternion in MuJoCo's order."""
    quaternion = np.zeros(4)
    mujoco.mju_euler2Quat(quaternion, np.array(rpy, dtype=float), "XYZ")
    return [float(value) for value in quaternion]


def link_geom(shape: CollisionPrimitive) -> dict[str, Any]:
    """A shape of a link as arguments of `add_geom`, in the frame of the link."""
    if shape.kind == "cuboid":
        size = [0.5 * edge for edge in shape.size]
        return {"type": _TYPES["cuboid"], "pos": shape.center, "quat": wxyz(shape.orientation), "size": size}
    if shape.kind == "sphere":
        return {"type": _TYPES["sphere"], "pos": shape.center, "size": [shape.radius, 0.0, 0.0]}
    return {"type": _TYPES[shape.kind], "fromto": [*shape.a, *shape.b], "size": [shape.radius, 0.0, 0.0]}


def object_geoms(item: SceneObject) -> Iterator[dict[str, Any]]:
    """The shapes of an object as arguments of `add_geom`, in the frame of the object; none for a mesh without data."""
    if item.kind == "cuboid":
        yield {"type": _TYPES["cuboid"], "size": [0.5 * edge for edge in item.size]}
    elif item.kind == "sphere":
        yield {"type": _TYPES["sphere"], "size": [item.radius, 0.0, 0.0]}
    elif item.kind in ("capsule", "cylinder"):
        yield {"type": _TYPES[item.kind], "size": [item.radius, 0.5 * item.length, 0.0]}
    elif item.kind == "voxels":
        half = [0.5 * item.resolution] * 3
        for cell in item.cells:
            yield {"type": _TYPES["cuboid"], "pos": [item.resolution * index for index in cell], "size": half}


def pose_of(item: SceneObject) -> tuple[Vector3, list[float]]:
    """Position (m) and orientation, in MuJoCo's order, of an object."""
    return item.position, [1.0, 0.0, 0.0, 0.0] if item.kind == "sphere" else wxyz(item.orientation)
