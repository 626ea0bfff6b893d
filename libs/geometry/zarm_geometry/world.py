"""The obstacles of one scene, packed once for the collision kernels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from zarm_contract.messages import Mesh, Primitive, SceneObject, Voxels
from zarm_geometry import rows
from zarm_geometry.frames import matrix
from zarm_geometry.kernels.arrays import WorldArrays
from zarm_geometry.meshes import Meshes
from zarm_geometry.voxels import edges, merged

Array = NDArray[np.float64]

BRANCHES = 4
"""Children per node of the tree of boxes."""


class World:
    """Scene objects in the base frame, with `margin` (m) added all around in `arrays`. Immutable.

    `rows` (n, 17) are the convex shapes that the objects consist of, in the order of the tree and without the margin, see
    `zarm_geometry.rows`; `owner` (n,) is the index in `names` of the object that each is part of. Raises Unavailable for a
    mesh that is not in `meshes`.
    """

    def __init__(self, objects: Sequence[SceneObject], margin: float, meshes: Meshes | None = None) -> None:
        shapes, owner = convex_shapes(objects, meshes or Meshes())
        lower, upper = rows.bounds(shapes)
        order = _along_a_curve((lower + upper) / 2)
        self.names = tuple(item.name for item in objects)
        self.margin = margin
        self.rows, self.owner = shapes[order], owner[order]
        grown = self.rows + margin * (np.arange(rows.WIDTH) == rows.WIDTH - 1)
        self.arrays = _packed(grown, lower[order] - margin, upper[order] + margin)


def convex_shapes(objects: Sequence[SceneObject], meshes: Meshes) -> tuple[Array, NDArray[np.intp]]:
    """The shapes (n, 17) of objects, and the index (n,) of the object that each belongs to."""
    single: list[Primitive] = []
    indices: list[int] = []
    parts, owners = [], []
    for index, item in enumerate(objects):
        if isinstance(item, Mesh | Voxels):
            own = meshes.rows(item) if isinstance(item, Mesh) else _boxes(item)
            parts.append(rows.placed(own, matrix(item.position, item.orientation)))
            owners.append(np.full(len(own), index))
        else:
            single.append(item)
            indices.append(index)
    parts.append(rows.primitives(single))
    owners.append(np.array(indices, np.intp))
    return np.concatenate(parts), np.concatenate(owners)


def _boxes(item: Voxels) -> Array:
    """The shapes (n, 17) of voxels, in their own frame."""
    return rows.boxes(*edges(*merged(np.array(item.cells)), item.resolution))


def _along_a_curve(points: Array) -> NDArray[np.intp]:
    """The order of points (n, 3) along Morton's curve, so that neighbours in it are neighbours in space."""
    low = points.min(axis=0, initial=0.0)
    high = points.max(axis=0, initial=0.0)
    cells = ((points - low) / np.maximum(high - low, 1e-9) * 1023).astype(np.int64)
    for shift, mask in _SPREAD:
        cells = (cells | cells << shift) & mask
    return np.argsort(cells @ np.array([1, 2, 4]), kind="stable")


_SPREAD = ((16, 0x030000FF), (8, 0x0300F00F), (4, 0x030C30C3), (2, 0x09249249))
"""Steps that put two zeros between the bits of a number below 1024."""


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
