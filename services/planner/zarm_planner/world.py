"""The obstacles of one scene, packed once for the collision kernels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from zarm_contract.messages import Cuboid, Cylinder, SceneObject, Sphere
from zarm_planner.frames import rotation
from zarm_planner.kernels.arrays import WorldArrays

Array = NDArray[np.float64]

BRANCHES = 4
"""Children per node of the tree of boxes."""


class World:
    """Scene objects in the base frame, with `margin` (m) added all around in `arrays`. Immutable.

    `rows` (n, 17) are the convex shapes that the objects consist of, in the order of the tree and without the margin, as
    `WorldArrays.shapes` describes them; `owner` (n,) is the index in `names` of the object that each is part of.
    """

    def __init__(self, objects: Sequence[SceneObject], margin: float) -> None:
        parts = [_rows(item) for item in objects]
        rows = np.concatenate([np.empty((0, 17)), *parts])
        owner = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
        lower, upper = _corners(rows)
        order = _along_a_curve((lower + upper) / 2)
        self.names = tuple(item.name for item in objects)
        self.margin = margin
        self.rows, self.owner = rows[order], owner[order]
        grown = self.rows + margin * (np.arange(17) == 16)
        self.arrays = _packed(grown, lower[order] - margin, upper[order] + margin)


def _rows(item: SceneObject) -> Array:
    """The shapes (n, 17) of one object."""
    turn = np.eye(3) if isinstance(item, Sphere) else rotation(item.orientation).T
    place = np.column_stack((turn, -turn @ np.array(item.position)))
    if isinstance(item, Cuboid):
        x, y, z = item.size
        core = (x / 2, y / 2, z / 2, 0.0, 0.0)
    elif isinstance(item, Sphere):
        core = (0.0, 0.0, 0.0, 0.0, item.radius)
    elif isinstance(item, Cylinder):
        core = (0.0, 0.0, item.length / 2, item.radius, 0.0)
    else:
        core = (0.0, 0.0, item.length / 2, 0.0, item.radius)
    return np.array([[*place.ravel(), *core]])


def _corners(shapes: Array) -> tuple[Array, Array]:
    """Lower and upper corners (n, 3) of the axis-aligned boxes around shapes."""
    turn = shapes[:, :12].reshape(-1, 3, 4)
    center = -np.einsum("nij,ni->nj", turn[:, :, :3], turn[:, :, 3])
    # A disc of radius r across the axis a reaches r * sqrt(1 - a_i^2) along the direction i.
    disc = shapes[:, 15:16] * np.sqrt(np.maximum(0.0, 1.0 - turn[:, 2, :3] ** 2))
    half = np.einsum("nij,ni->nj", np.abs(turn[:, :, :3]), shapes[:, 12:15]) + disc + shapes[:, 16:17]
    return center - half, center + half


def _along_a_curve(points: Array) -> NDArray[np.intp]:
    """The order of points (n, 3) along Morton's curve, so that neighbours in it are neighbours in space."""
    low = points.min(axis=0, initial=0.0)
    high = points.max(axis=0, initial=0.0)
    cells = ((points - low) / np.maximum(high - low, 1e-9) * 1023).astype(np.int64)
    code = np.zeros(len(points), np.int64)
    for bit in range(10):
        for axis in range(3):
            code |= ((cells[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.argsort(code, kind="stable")


def _packed(shapes: Array, lower: Array, upper: Array) -> WorldArrays:
    """The tree over shapes in their order: each level joins BRANCHES neighbours; nodes lie depth first."""
    count = len(shapes)
    widths = [1]
    while widths[-1] * BRANCHES < count:
        widths.append(widths[-1] * BRANCHES)

    def nodes_before(shape: NDArray[np.intp]) -> NDArray[np.intp]:
        return np.asarray(np.sum([-(-shape // width) for width in widths], axis=0), np.intp)

    total = int(nodes_before(np.array(count)))
    boxes = np.empty((total, 6))
    skip = np.empty(total, np.int32)
    leaf = np.full(total, -1, np.int32)
    for level, width in enumerate(widths):
        first = np.arange(0, count, width)
        ancestors = sum((first % wider == 0 for wider in widths[level + 1 :]), np.zeros(len(first), np.intp))
        at = nodes_before(first) + ancestors
        low, high = np.minimum.reduceat(lower, first), np.maximum.reduceat(upper, first)
        boxes[at] = np.hstack(((low + high) / 2, (high - low) / 2))
        skip[at] = nodes_before(np.minimum(first + width, count))
        if level == 0:
            leaf[at] = first
    return WorldArrays(shapes.astype(np.float32), boxes.astype(np.float32), skip, leaf)
