"""Surfaces as triangles (n, 3, 3): fewer of them, points on them, areas."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from zarm_trajectory.arrays import Array

_THINNED = 2000
"""Number of triangles that is enough to decide what is inside."""


def gathered(triangles: Array, most: int) -> tuple[Array, float]:
    """At most `most` triangles instead of these (n, 3, 3), with vertices on a grid, and the greatest distance (m) to
    the original.
    """
    size = max(float(np.ptp(triangles.reshape(-1, 3), axis=0).max()) / 400, 1e-5)
    given, off = triangles, 0.0
    while len(triangles) > most:
        cells = np.unique(np.round(given / size).astype(np.int32).reshape(-1, 9), axis=0)
        triangles = np.asarray(cells.reshape(-1, 3, 3) * size, np.float64)
        off = size * math.sqrt(3) / 2
        size *= 1.4
    return triangles, off


def thinned(triangles: Array) -> Array:
    """At most `_THINNED` triangles close to these, whose vertices are merged in cells."""
    size = max(float(np.ptp(triangles.reshape(-1, 3), axis=0).max()) / 200, 1e-5)
    given = triangles
    while len(triangles) > _THINNED:
        cells = np.round(given / size).astype(np.int64)
        a, b, c = cells.transpose(1, 0, 2)
        kept = (a != b).any(axis=1) & (b != c).any(axis=1) & (c != a).any(axis=1)
        triangles = cells[kept] * size
        size *= 1.4
    return triangles


def points_on(triangles: Array, count: int, seed: int = 0) -> tuple[Array, NDArray[np.intp]]:
    """Points (count, 3) spread evenly over triangles (n, 3, 3), and the triangle of each."""
    rng = np.random.default_rng(seed)
    sizes = areas(triangles)
    steps = (np.arange(count) + rng.random(count)) / count * sizes.sum()
    which = np.minimum(np.searchsorted(np.cumsum(sizes), steps), len(sizes) - 1)
    u, v = rng.random((2, count, 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    a, b, c = triangles[which].transpose(1, 0, 2)
    return a + u * (b - a) + v * (c - a), which


def areas(triangles: Array) -> Array:
    """Areas of triangles (n, 3, 3), in m^2."""
    found: Array = (
        np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1) / 2
    )
    return found
