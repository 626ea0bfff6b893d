"""The directions in which planes and primitives are tried on a piece of a link."""

from __future__ import annotations

import math

import numpy as np

from zarm_geometry.frames import rotation_to
from zarm_trajectory.arrays import Array

_SAME_AXIS_COSINE = math.cos(math.radians(1.0))
"""Axes whose angle has a larger cosine count as the same."""
_ORDERS = ([1, 2, 0], [2, 0, 1], [0, 1, 2])


def axes_of(points: Array, triangles: Array, known: Array) -> Array:
    """The frames `known` (n, 3, 3) and more, with z along the directions in which planes and primitives are tried.

    They are the axes of the link, the principal ones of points (k, 3) on its surface, and those of its largest flat
    faces.
    """
    found = list(known[::3])
    main = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2].T
    main[:, 2] *= np.linalg.det(main)  # right-handed
    for triple in (*(() if found else (np.eye(3),)), main, _faces(triangles)):
        if not found or np.abs(triple.T @ np.concatenate(found, axis=1)).max(axis=1).min() < _SAME_AXIS_COSINE:
            found.append(triple)
    return np.array([triple[:, order] for triple in found for order in _ORDERS])


def _faces(triangles: Array) -> Array:
    """Axes (3, 3): the direction that most area faces, that of most area perpendicular to it, and their normal."""
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    sizes = np.linalg.norm(normals, axis=1)
    if not sizes.any():
        return np.eye(3)
    normals, sizes = normals[sizes > 0.0] / sizes[sizes > 0.0, None], sizes[sizes > 0.0]
    normals *= np.where(normals @ (1.0, 0.1, 0.01) < 0.0, -1.0, 1.0)[:, None]
    names, group = np.unique(np.round(normals, 2), axis=0, return_inverse=True)
    total = np.bincount(group, sizes, len(names))

    def largest(which: int) -> Array:
        found: Array = normals[np.argmax(np.where(group == which, sizes, 0.0))]
        return found

    first = largest(int(total.argmax()))
    across = total * (np.abs(names @ first) < 0.05)
    if not across.any():
        return rotation_to(first)
    second = np.cross(np.cross(first, largest(int(across.argmax()))), first)
    second /= np.linalg.norm(second)
    return np.column_stack((first, second, np.cross(first, second)))
