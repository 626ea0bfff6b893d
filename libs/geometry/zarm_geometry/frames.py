"""Conversions between the quaternions of messages and rotation matrices."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from zarm_contract.messages import Pose, Quaternion, Vector3
from zarm_trajectory.arrays import Array


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


def rotated_by(vectors: Array) -> Array:
    """The rotation matrices (n, 3, 3) of rotation vectors (n, 3) in rad, by Rodrigues' formula."""
    if not vectors.any():
        return np.broadcast_to(np.eye(3), (len(vectors), 3, 3))
    square = np.einsum("ij,ij->i", vectors, vectors)
    angle = np.sqrt(square)
    small = angle < 1e-4
    safe = np.where(small, 1.0, angle)
    sine = np.where(small, 1.0 - square / 6.0, np.sin(safe) / safe)
    cosine = np.where(small, 0.5 - square / 24.0, (1.0 - np.cos(safe)) / safe**2)
    cross = np.zeros((len(vectors), 3, 3))
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -vectors[:, 2], vectors[:, 1], -vectors[:, 0]
    cross -= cross.transpose(0, 2, 1)
    square_of = vectors[:, :, None] * vectors[:, None, :] - square[:, None, None] * np.eye(3)
    return np.asarray(np.eye(3) + sine[:, None, None] * cross + cosine[:, None, None] * square_of)


def rotation_to(axis: ArrayLike) -> Array:
    """A rotation matrix (3, 3) that takes z to the direction of `axis` (3,)."""
    z = np.asarray(axis, np.float64) / np.linalg.norm(axis)
    x = np.cross((0.0, 1.0, 0.0) if abs(z[1]) < 0.9 else (0.0, 0.0, 1.0), z)
    x /= np.linalg.norm(x)
    return np.column_stack((x, np.cross(z, x), z))


def of_rpy(rpy: Vector3) -> Array:
    """A rotation matrix (3, 3): Rz(yaw) Ry(pitch) Rx(roll), the order of the URDF specification."""
    (cr, cp, cy), (sr, sp, sy) = (tuple(map(f, rpy)) for f in (math.cos, math.sin))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


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
    (xx, xy, xz, px), (yx, yy, yz, py), (zx, zy, zz, pz) = matrix[:3].tolist()
    trace = xx + yy + zz
    if trace > max(xx, yy, zz):
        x, y, z, w = zy - yz, xz - zx, yx - xy, 1.0 + trace
    elif xx >= max(yy, zz):
        x, y, z, w = 1.0 - trace + 2.0 * xx, yx + xy, zx + xz, zy - yz
    elif yy >= zz:
        x, y, z, w = xy + yx, 1.0 - trace + 2.0 * yy, zy + yz, xz - zx
    else:
        x, y, z, w = xz + zx, yz + zy, 1.0 - trace + 2.0 * zz, yx - xy
    scale = math.copysign(1.0, w) / math.sqrt(x * x + y * y + z * z + w * w)
    return Pose(position=(px, py, pz), orientation=(scale * x, scale * y, scale * z, scale * w))
