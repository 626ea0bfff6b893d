"""A smooth body around the exact geometry of a link: its primitives, blended into each other."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import trimesh
from numpy.typing import NDArray

from zarm_contract.collision import CollisionCapsule, CollisionCylinder, CollisionPrimitive, CollisionSphere
from zarm_trajectory.arrays import Array

Distance = Callable[[Array], Array]

DEVIATION = 0.01
"""How far (m) a point of the skin is from the surface of the primitives, at most; creases between them are filled."""
_BLEND = 4.0 * DEVIATION
"""Distance (m) within which two primitives blend: the skin stands out by a quarter of it where they are equally near."""
_ROUNDING = 0.006
"""Radius (m) of the edges of cylinders."""
_CELL = 0.01
_CELLS = 6
"""Edge of the grid's cells (m), and how many there are across the link, at least."""
_STEPS = 4


def skin(primitives: Sequence[CollisionPrimitive]) -> trimesh.Trimesh | None:
    """The skin of a link in its frame; None for one that has edges, as boxes have, or consists of one primitive."""
    if len(primitives) < 2:
        return None
    distances = []
    corners = []
    for primitive in primitives:
        if not isinstance(primitive, CollisionSphere | CollisionCapsule | CollisionCylinder):
            return None
        a, b = (primitive.center,) * 2 if isinstance(primitive, CollisionSphere) else (primitive.a, primitive.b)
        distances.append(_round(np.array(a), np.array(b), primitive.radius, isinstance(primitive, CollisionCylinder)))
        corners += [np.array([a, b]) - primitive.radius, np.array([a, b]) + primitive.radius]
    lower, upper = np.vstack(corners).min(axis=0), np.vstack(corners).max(axis=0)
    cell = min(_CELL, float((upper - lower).min()) / _CELLS)
    return _surface(_blended(distances), lower - 2 * cell - DEVIATION, upper + 2 * cell + DEVIATION, cell)


def _round(a: Array, b: Array, radius: float, flat: bool) -> Distance:
    """The signed distance (n,) in m of points (n, 3) from a capsule, or from a cylinder with rounded edges."""
    length = float(np.linalg.norm(b - a))
    axis = (b - a) / length if length > 0.0 else np.array([0.0, 0.0, 1.0])
    rounding = min(_ROUNDING, radius, length / 2.0)

    def distance(points: Array) -> Array:
        from_a = points - a
        along = from_a @ axis
        across = np.sqrt(np.maximum((from_a**2).sum(axis=1) - along**2, 0.0))
        if not flat:
            return np.asarray(np.hypot(across, along - np.clip(along, 0.0, length)) - radius)
        beyond = np.abs(along - length / 2.0) - (length / 2.0 - rounding)
        outside = across - (radius - rounding)
        return np.asarray(
            np.minimum(np.maximum(beyond, outside), 0.0)
            + np.hypot(np.maximum(beyond, 0.0), np.maximum(outside, 0.0))
            - rounding
        )

    return distance


def _blended(distances: Sequence[Distance]) -> Distance:
    """Their union, with fillets: the polynomial smooth minimum (Quilez, "Smooth minimum", 2013), at most DEVIATION outside."""

    def distance(points: Array) -> Array:
        blended = nearest = distances[0](points)
        for one in distances[1:]:
            other = one(points)
            nearest = np.minimum(nearest, other)
            near = np.maximum(_BLEND - np.abs(blended - other), 0.0)
            blended = np.minimum(blended, other) - near**2 / (4.0 * _BLEND)
        return np.maximum(blended, nearest - DEVIATION)

    return distance


def _surface(distance: Distance, lower: Array, upper: Array, cell: float) -> trimesh.Trimesh:
    """The surface where a distance is 0, by surface nets (Gibson, "Constrained elastic surface nets", 1998)."""
    counts = np.ceil((upper - lower) / cell).astype(int) + 1
    grid = np.stack(np.meshgrid(*(np.arange(count) for count in counts), indexing="ij"), axis=-1)
    inside = distance(lower + cell * grid.reshape(-1, 3)).reshape(counts) < 0.0
    corners = np.lib.stride_tricks.sliding_window_view(inside, (2, 2, 2)).reshape(*(counts - 1), 8)
    mixed = corners.any(axis=-1) & ~corners.all(axis=-1)  # the cells that the surface goes through
    number = np.full(mixed.shape, -1)
    number[mixed] = np.arange(np.count_nonzero(mixed))
    points = _on_surface(distance, lower + cell * (np.argwhere(mixed) + 0.5), cell)
    return trimesh.Trimesh(points, _faces(inside, number), process=False)


def _on_surface(distance: Distance, points: Array, cell: float) -> Array:
    """The points (n, 3), moved to the surface."""
    step = 1e-3 * cell
    for _ in range(_STEPS):
        away = distance(points)
        slope = np.column_stack([(distance(points + offset) - away) / step for offset in step * np.eye(3)])
        steep = np.maximum((slope**2).sum(axis=1), 0.25)
        points = points - np.clip(away / steep, -cell / 2, cell / 2)[:, None] * slope
    return points


def _faces(inside: NDArray[np.bool_], number: NDArray[np.intp]) -> NDArray[np.intp]:
    """Two triangles (n, 3) for each edge of the grid that the surface crosses, between the cells around it."""
    faces = []
    for axis in range(3):
        solid, cells = np.moveaxis(inside, axis, 0), np.moveaxis(number, axis, 0)
        begin, end = solid[:-1, 1:-1, 1:-1], solid[1:, 1:-1, 1:-1]
        corners = np.stack([cells[:, :-1, :-1], cells[:, 1:, :-1], cells[:, 1:, 1:], cells[:, :-1, 1:]], axis=-1)
        out, into = corners[begin & ~end], corners[~begin & end][:, ::-1]
        quads = np.concatenate([out, into]) if axis != 1 else np.concatenate([out, into])[:, ::-1]
        faces += [quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]
    return np.concatenate(faces)
