"""Boxes around shapes, and around the nodes of a bounding volume hierarchy: refitted to shapes that were moved, its nodes
stay, and their boxes are recomputed from the leaves up.
"""

from __future__ import annotations

import math

import numpy as np

from zarm_geometry.kernels.compiled import inlined, kernel
from zarm_trajectory.arrays import Array, Index


@inlined
def _bounds(row: Array, box: Array) -> None:
    """Write to `box` (6,) centre and half extents of the axis-aligned box around a shape (17,), see
    `zarm_geometry.packed_shapes`.
    """
    rounding = row[16]
    for j in range(3):
        x, y, z = row[j], row[4 + j], row[8 + j]
        center = -(x * row[3] + y * row[7] + z * row[11])
        if row[15] < 0.0:
            second, third = center + x * row[12], center + x * row[13] + y * row[14]
            lower, upper = min(center, second, third), max(center, second, third)
            box[j], box[3 + j] = (lower + upper) / 2, (upper - lower) / 2 + rounding
        else:
            half = abs(x) * row[12] + abs(y) * row[13] + abs(z) * row[14]
            # A disc of radius r normal to the axis a extends r * sqrt(1 - a_j^2) along the direction j.
            box[j], box[3 + j] = center, half + row[15] * math.sqrt(max(0.0, 1.0 - z * z)) + rounding


@kernel
def centers(shapes: Array) -> Array:
    """The centres (n, 3) of the axis-aligned boxes around shapes (n, 17)."""
    found, box = np.empty((len(shapes), 3)), np.empty(6)
    for i in range(len(shapes)):
        _bounds(shapes[i], box)
        for j in range(3):
            found[i, j] = box[j]
    return found


@kernel
def refit(shapes: Array, skip: Index, leaf: Index, pose: Array) -> tuple[Array, Array]:
    """The shapes (n, 17) of an object at `pose` (4, 4), from those in its own frame, and the boxes (m, 6) of their
    tree.
    """
    placed, boxes = np.empty_like(shapes), np.empty((len(skip), 6))
    for i in range(len(shapes)):
        for r in range(0, 12, 4):
            shift = shapes[i, r + 3]
            for j in range(3):
                turned = shapes[i, r] * pose[j, 0] + shapes[i, r + 1] * pose[j, 1] + shapes[i, r + 2] * pose[j, 2]
                placed[i, r + j] = turned
                shift -= turned * pose[j, 3]
            placed[i, r + 3] = shift
        for c in range(12, 17):
            placed[i, c] = shapes[i, c]
    for node in range(len(skip) - 1, -1, -1):
        if leaf[node] >= 0:
            _bounds(placed[leaf[node]], boxes[node])
            continue
        for j in range(3):
            lower, upper = math.inf, -math.inf
            child = node + 1
            while child < skip[node]:
                lower = min(lower, boxes[child, j] - boxes[child, 3 + j])
                upper = max(upper, boxes[child, j] + boxes[child, 3 + j])
                child = skip[child]
            boxes[node, j], boxes[node, 3 + j] = (lower + upper) / 2, (upper - lower) / 2
    return placed, boxes
