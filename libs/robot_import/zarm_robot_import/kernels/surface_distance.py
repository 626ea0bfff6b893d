"""Distances of points to triangles."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.kernels.compiled import inlined, kernel
from zarm_geometry.kernels.convex import Vector
from zarm_trajectory.arrays import Array


@kernel
def least_distances(points: Array, triangles: Array, which: NDArray[np.intp]) -> Array:
    """The distance (n,) of each of the points (n, 3) to the nearest of its triangles, which are those of m triangles
    (m, 3, 3) whose indices are in its row of `which` (n, k); they may be degenerate.
    """
    found = np.empty(len(points))
    for i in range(len(points)):
        p = (points[i, 0], points[i, 1], points[i, 2])
        least = np.inf
        for j in which[i]:
            t = triangles[j]
            a, b, c = (t[0, 0], t[0, 1], t[0, 2]), (t[1, 0], t[1, 1], t[1, 2]), (t[2, 0], t[2, 1], t[2, 2])
            least = min(least, _square(p, a, b, c))
        found[i] = math.sqrt(least)
    return found


@inlined
def _square(p: Vector, a: Vector, b: Vector, c: Vector) -> float:
    """The squared distance of a point to the triangle a, b, c: to its plane if the point is above or below it, or to its
    edges.
    """
    normal = _cross(_minus(b, a), _minus(c, a))
    size = _dot(normal, normal)
    if size > 0.0 and _left(p, a, b, normal) and _left(p, b, c, normal) and _left(p, c, a, normal):
        height = _dot(_minus(p, a), normal)
        return height * height / size
    return min(_to_edge(p, a, b), _to_edge(p, b, c), _to_edge(p, c, a))


@inlined
def _left(p: Vector, a: Vector, b: Vector, normal: Vector) -> bool:
    return _dot(_cross(_minus(b, a), _minus(p, a)), normal) >= 0.0


@inlined
def _to_edge(p: Vector, a: Vector, b: Vector) -> float:
    edge, away = _minus(b, a), _minus(p, a)
    length = _dot(edge, edge)
    share = min(max(_dot(away, edge) / length, 0.0), 1.0) if length > 0.0 else 0.0
    off = (away[0] - share * edge[0], away[1] - share * edge[1], away[2] - share * edge[2])
    return _dot(off, off)


@inlined
def _minus(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@inlined
def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
