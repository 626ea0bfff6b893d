"""Conversions between the quaternions of messages and rotation matrices."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from zarm_contract.messages import Pose, Quaternion, Vector3

Array = NDArray[np.float64]


def rotation(q: Quaternion) -> Array:
    """The rotation matrix (3, 3) of a unit quaternion (x, y, z, w)."""
    x, y, z, w = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def rotations(q: Array) -> Array:
    """The rotation matrices (n, 3, 3) of unit quaternions (n, 4)."""
    return np.moveaxis(rotation(tuple(q.T)), 2, 0)


def rotation_to(axis: ArrayLike) -> Array:
    """A rotation matrix (3, 3) that takes z to the direction of `axis` (3,)."""
    z = np.asarray(axis, np.float64) / np.linalg.norm(axis)
    x = np.cross((0.0, 1.0, 0.0) if abs(z[1]) < 0.9 else (0.0, 0.0, 1.0), z)
    x /= np.linalg.norm(x)
    return np.column_stack((x, np.cross(z, x), z))


def matrix(position: Vector3, orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)) -> Array:
    """The pose as a matrix (4, 4)."""
    pose = np.eye(4)
    pose[:3, :3] = rotation(orientation)
    pose[:3, 3] = position
    return pose


def pose_of(matrix: Array) -> Pose:
    """The message of a pose (4, 4); its quaternion has w >= 0.

    The largest of the four components is computed from the diagonal (Shepperd, "Quaternion from rotation matrix",
    1978).
    """
    r = matrix[:3, :3]
    diagonal = np.array([r[0, 0], r[1, 1], r[2, 2], float(np.trace(r))])
    largest = int(np.argmax(diagonal))
    q = np.empty(4)
    if largest == 3:
        q[:] = r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], 1 + diagonal[3]
    else:
        i, j, k = largest, (largest + 1) % 3, (largest + 2) % 3
        q[i], q[j], q[k], q[3] = 1 - diagonal[3] + 2 * r[i, i], r[j, i] + r[i, j], r[k, i] + r[i, k], r[k, j] - r[j, k]
    q *= math.copysign(1.0, q[3]) / np.linalg.norm(q)
    x, y, z, w = q.tolist()
    px, py, pz = matrix[:3, 3].tolist()
    return Pose(position=(px, py, pz), orientation=(x, y, z, w))
