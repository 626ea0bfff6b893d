"""Convex shapes as rows of 17 numbers, the form of all obstacles.

The first 12 are the base frame in the shape's (3, 4), row by row; then come half extents x, y, z of its core, the
radius of a disc about z that widens the core, and the rounding added all around. So a cuboid is its extents, a sphere a
rounding, a capsule a segment with a rounding, a cylinder a segment with a disc. If the radius is negative, the core is
the triangle (0, 0), (b, 0), (c, d) in the plane z = 0, and b, c, d replace the half extents.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from zarm_contract.messages import Cuboid, Cylinder, Primitive, Sphere
from zarm_geometry.frames import rotations
from zarm_trajectory.arrays import Array

WIDTH = 17
"""Numbers per shape."""
THINNEST_TRIANGLE = 1e-6
"""Triangles with less height (m) over their longest edge are ignored."""


def primitives(items: Sequence[Primitive]) -> Array:
    """Primitives (n, 17) in the frame of their poses."""
    table = np.empty((len(items), 12))
    for row, item in zip(table, items, strict=True):
        row[:3], row[3:7], row[7:] = item.position, (0.0, 0.0, 0.0, 1.0), 0.0
        if isinstance(item, Sphere):
            row[11] = item.radius
            continue
        row[3:7] = item.orientation
        if isinstance(item, Cuboid):
            row[7:10] = item.size
            row[7:10] /= 2
        else:
            row[9] = item.length / 2
            row[10 if isinstance(item, Cylinder) else 11] = item.radius
    turn = rotations(table[:, 3:7]).transpose(0, 2, 1)
    frame = np.concatenate([turn, -turn @ table[:, :3, None]], axis=2)
    return np.column_stack([frame.reshape(-1, 12), table[:, 7:]])


def boxes(lower: Array, upper: Array) -> Array:
    """Axis-aligned boxes (n, 17) from their corners (n, 3)."""
    rows = np.zeros((len(lower), WIDTH))
    rows[:, [0, 5, 10]] = 1.0
    rows[:, [3, 7, 11]] = -(lower + upper) / 2
    rows[:, 12:15] = (upper - lower) / 2
    return rows


def triangles(corners: Array) -> Array:
    """Triangles (m, 17) from their corners (n, 3, 3), without degenerate ones."""
    edges = np.roll(corners, -1, axis=1) - corners
    longest = np.argmax(np.linalg.norm(edges, axis=2), axis=1)
    each = np.arange(len(corners))
    a = corners[each, longest]
    base, side = edges[each, longest], corners[each, (longest + 2) % 3] - a
    b = np.linalg.norm(base, axis=1)
    area = np.linalg.norm(np.cross(base, side), axis=1)
    thick = area >= np.maximum(b, THINNEST_TRIANGLE) * THINNEST_TRIANGLE
    a, base, side, b = a[thick], base[thick], side[thick], b[thick]
    x = base / b[:, None]
    c = np.einsum("ni,ni->n", x, side)
    y = side - c[:, None] * x
    d = np.linalg.norm(y, axis=1)
    y /= d[:, None]
    turn = np.stack([x, y, np.cross(x, y)], axis=1)
    frame = np.concatenate([turn, -(turn @ a[:, :, None])], axis=2)
    return np.column_stack([frame.reshape(-1, 12), b, c, d, np.full(len(b), -1.0), np.zeros(len(b))])


def corners(rows: Array) -> Array:
    """The corners (n, 3, 3) of triangles (n, 17)."""
    b, c, d = rows[:, 12:15].T
    zero = np.zeros(len(rows))
    local = np.stack([np.column_stack(xyz) for xyz in ((zero, zero, zero), (b, zero, zero), (c, d, zero))], axis=1)
    frame = rows[:, :12].reshape(-1, 3, 4)
    found: Array = np.einsum("nij,nki->nkj", frame[:, :, :3], local - frame[:, None, :, 3])
    return found


def placed(rows: Array, pose: Array) -> Array:
    """Shapes (n, 17) of an object at `pose` (4, 4), from those in the object's own frame."""
    turn = rows[:, :12].reshape(-1, 3, 4)[:, :, :3] @ pose[:3, :3].T
    shift = rows[:, [3, 7, 11]] - turn @ pose[:3, 3]
    return np.column_stack([np.concatenate([turn, shift[:, :, None]], axis=2).reshape(-1, 12), rows[:, 12:]])


def bounds(rows: Array) -> tuple[Array, Array]:
    """Lower and upper corners (n, 3) of the axis-aligned boxes around shapes."""
    frame = rows[:, :12].reshape(-1, 3, 4)
    turn = frame[:, :, :3]
    center = -np.einsum("nij,ni->nj", turn, frame[:, :, 3])
    # A disc of radius r across the axis a reaches r * sqrt(1 - a_i^2) along the direction i.
    disc = rows[:, 15:16] * np.sqrt(np.maximum(0.0, 1.0 - turn[:, 2] ** 2))
    half = np.einsum("nij,ni->nj", np.abs(turn), rows[:, 12:15]) + disc
    lower, upper = center - half, center + half
    flat = rows[:, 15] < 0.0
    if flat.any():
        points = corners(rows[flat])
        lower[flat], upper[flat] = points.min(axis=1), points.max(axis=1)
    return lower - rows[:, 16:], upper + rows[:, 16:]


def distances(points: Array, rows: Array) -> Array:
    """Distances (n, m) of points (n, 3) to the surfaces of shapes (m, 17), negative inside; a triangle has no inside."""
    frame = rows[:, :12].reshape(-1, 3, 4)
    local = np.einsum("mij,nj->nmi", frame[:, :, :3], points) + frame[:, :, 3]
    out = np.abs(local) - rows[:, 12:15]
    # A cylinder is a rectangle in the plane of its axis and the radius; both x and y map to the radius.
    disc = rows[:, 15]
    out[..., 0] = np.where(disc > 0.0, np.hypot(local[..., 0], local[..., 1]) - disc, out[..., 0])
    out[..., 1] = np.where(disc > 0.0, out[..., 0], out[..., 1])
    beyond = out.clip(0.0)
    beyond[..., 1] = np.where(disc > 0.0, 0.0, beyond[..., 1])
    found: Array = np.linalg.norm(beyond, axis=-1) + np.minimum(out.max(axis=-1), 0.0)
    flat = disc < 0.0
    found[:, flat] = _to_triangles(local[:, flat], rows[flat])
    return found - rows[:, 16]


def _to_triangles(points: Array, rows: Array) -> Array:
    """Distances (n, m) of points (n, m, 3), each in the frame of its triangle, to triangles (m, 17)."""
    b, c, d = rows[:, 12:15].T
    zero = np.zeros_like(b)
    ends = [np.column_stack(corner) for corner in ((zero, zero), (b, zero), (c, d))]
    inside = np.ones(points.shape[:2], bool)
    nearest = np.full(points.shape[:2], np.inf)
    for start, end in ((ends[0], ends[1]), (ends[1], ends[2]), (ends[2], ends[0])):
        edge, away = end - start, points[..., :2] - start
        inside &= edge[:, 0] * away[..., 1] >= edge[:, 1] * away[..., 0]
        part = np.clip((away * edge).sum(axis=-1) / (edge * edge).sum(axis=-1), 0.0, 1.0)
        nearest = np.minimum(nearest, np.linalg.norm(away - part[..., None] * edge, axis=-1))
    return np.hypot(np.where(inside, 0.0, nearest), points[..., 2])
