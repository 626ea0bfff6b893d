"""Cuts a cell in two by a plane."""

from __future__ import annotations

import numpy as np

from zarm_robot_import.body import Body
from zarm_robot_import.cells import Cell, form_of, piece, tightest
from zarm_trajectory.arrays import Array

_CUTS = 5
"""Planes tried along each axis."""
_MIN_POINTS_PER_SIDE = 25
"""Least number of points on each side of a plane."""


def halves(cell: Cell, axes: Array, body: Body, outside: tuple[Array, Array]) -> list[Cell]:
    """A cell cut in two by the plane that leaves the least outside the body; empty if there is none.

    `outside` counts beside the body's points: points (n, 3) on the cell's primitive, and the cost (n,) of each.
    """
    best, chosen = np.inf, None
    points, weights = (np.concatenate(each) for each in zip(body.around(cell.points), outside, strict=True))
    order = np.argsort(-weights)
    near = points[order], weights[order]

    def left(axis: Array, offset: float) -> float:
        below = cell.points @ axis < offset
        if not _MIN_POINTS_PER_SIDE <= np.count_nonzero(below) <= len(below) - _MIN_POINTS_PER_SIDE:
            return np.inf
        out = 0.0
        for points in (cell.points[below], cell.points[~below]):
            out += tightest(points, form_of(points, cell.axes), near, best - out)[1]
            if out >= best:
                break
        return out

    for axis in cell.axes[:, :, 2]:
        along = cell.points @ axis
        low, high = float(along.min()), float(along.max())
        for offset in low + (high - low) * (np.arange(_CUTS) + 1) / (_CUTS + 1):
            if (out := left(axis, offset)) < best:
                best, chosen, step = out, (axis, float(offset)), (high - low) / (_CUTS + 1)
    if chosen is None:
        return []
    for _ in range(4):
        step /= 2
        axis, middle = chosen
        for offset in (middle - step, middle + step):
            if (out := left(axis, offset)) < best:
                best, chosen = out, (axis, offset)
    below, above, across = cut(cell.triangles, *chosen)
    high = cell.vertices @ chosen[0] > chosen[1]
    return [
        piece(part, np.concatenate([vertices, across]), axes, body)
        for part, vertices in ((below, cell.vertices[~high]), (above, cell.vertices[high]))
        if len(part)
    ]


def cut(triangles: Array, normal: Array, offset: float) -> tuple[Array, Array, Array]:
    """The triangles (n, 3, 3) below and above the plane of points x with normal * x = offset, cut where it intersects
    them, and the points (k, 3) of these cuts.
    """
    away = triangles @ normal - offset
    above = away > 0.0
    count = above.sum(axis=1)
    low, high = triangles[count == 0], triangles[count == 3]
    crossing = (count == 1) | (count == 2)
    some, heights, lone_above = triangles[crossing], away[crossing], count[crossing] == 1
    lone = np.argmax(above[crossing] == lone_above[:, None], axis=1)
    each = np.arange(len(some))
    turned = [(lone + k) % 3 for k in range(3)]
    a, b, c = (some[each, k] for k in turned)
    ha, hb, hc = (heights[each, k][:, None] for k in turned)
    ab, ac = a + (b - a) * (ha / (ha - hb)), a + (c - a) * (ha / (ha - hc))
    tip = np.stack((a, ab, ac), axis=1)
    rest = np.concatenate([np.stack((ab, b, c), axis=1), np.stack((ab, c, ac), axis=1)])
    twice = np.tile(lone_above, 2)
    return (
        np.concatenate([low, tip[~lone_above], rest[twice]]),
        np.concatenate([high, tip[lone_above], rest[~twice]]),
        np.concatenate([ab, ac]),
    )
