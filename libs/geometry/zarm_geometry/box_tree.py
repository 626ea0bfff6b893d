"""Trees of axis-aligned boxes over convex shapes."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from zarm_geometry import rows
from zarm_geometry.allowed_collisions import EVERY_LINK
from zarm_geometry.kernels.arrays import WorldArrays
from zarm_geometry.kernels.median_split import median_split
from zarm_geometry.kernels.refit import centers, refit

Array = NDArray[np.float64]
Index = NDArray[np.int32]

BRANCHES = 4
"""Children per node."""


class BoxTree(NamedTuple):
    """Shapes and the boxes around them.

    `rows` (n, 17) are the shapes as in `zarm_geometry.rows`, in the order of the tree, and `order` (n,) their original
    indices. `boxes` (m, 6), `skip` (m,) and `leaf` (m,) are its nodes, as in `WorldArrays`, without margin.
    """

    rows: Array
    order: NDArray[np.intp]
    boxes: Array
    skip: Index
    leaf: Index

    @classmethod
    def over(cls, shapes: Array) -> Self:
        """The tree over shapes (n, 17)."""
        order = median_split(centers(shapes), BRANCHES)
        skip, leaf = _nodes(len(shapes))
        there, boxes = refit(shapes[order], skip, leaf, np.eye(4))
        return cls(there, order, boxes, skip, leaf)

    def placed(self, pose: Array) -> Self:
        """The tree of an object at `pose` (4, 4), from the tree in the object's frame: a tenth of the work of a new
        one.
        """
        shapes, boxes = refit(self.rows, self.skip, self.leaf, pose)
        return self._replace(rows=shapes, boxes=boxes)


def joined(trees: Sequence[BoxTree], margin: float) -> WorldArrays:
    """One tree over all trees, for kernels: their shapes one after the other, with `margin` (m) around them."""
    first_shape = np.cumsum([0, *(len(tree.rows) for tree in trees)])[:-1]
    counts = np.array([len(tree.skip) for tree in trees])
    first_node = np.cumsum(counts) - counts
    boxes = np.concatenate([tree.boxes for tree in trees])
    grown = np.flatnonzero(counts)
    lower = np.minimum.reduceat(boxes[:, :3] - boxes[:, 3:], first_node[grown])
    upper = np.maximum.reduceat(boxes[:, :3] + boxes[:, 3:], first_node[grown])
    over = BoxTree.over(rows.boxes(lower, upper))
    # The nodes of a tree are below a node of `over`, or in its place if there is a single root, or no other tree.
    bottom = over.leaf >= 0
    below = grown[over.order[over.leaf[bottom]]]
    own = ~bottom
    own[bottom] = [len(grown) > 1 and trees[index].skip[0] != counts[index] for index in below]
    sizes = own.astype(np.intp)
    sizes[bottom] += counts[below]
    place = np.concatenate([[0], np.cumsum(sizes)])
    begin = np.zeros(len(trees), np.intp)
    begin[below] = place[1:][bottom] - counts[below]
    of = np.repeat(np.arange(len(trees)), counts)
    there, at = place[:-1][own], np.arange(len(of)) + (begin - first_node)[of]
    leaves = np.concatenate([tree.leaf for tree in trees])
    arrays = WorldArrays(
        np.concatenate([tree.rows for tree in trees], dtype=np.float32, casting="same_kind"),
        np.empty((place[-1], 6), np.float32),
        np.empty(place[-1], np.int32),
        np.empty(place[-1], np.int32),
        np.full(sum(len(tree.rows) for tree in trees), EVERY_LINK),
        margin,
    )
    arrays.boxes[there], arrays.boxes[at] = over.boxes[own], boxes
    arrays.skip[there], arrays.skip[at] = (
        place[over.skip[own]],
        np.concatenate([tree.skip for tree in trees]) + begin[of],
    )
    arrays.leaf[there], arrays.leaf[at] = -1, np.where(leaves < 0, leaves, leaves + first_shape[of])
    return arrays


@lru_cache(maxsize=256)
def _nodes(count: int) -> tuple[Index, Index]:
    """`skip` and `leaf` over this many shapes in order: each level joins BRANCHES neighbours; nodes are stored depth
    first. Not to be written to: all trees over as many shapes share them.
    """
    widths = [1]
    while widths[-1] * BRANCHES < count:
        widths.append(widths[-1] * BRANCHES)

    def nodes_before(shape: NDArray[np.intp]) -> NDArray[np.intp]:
        return np.asarray(np.sum([-(-shape // width) for width in widths], axis=0), np.intp)

    total = int(nodes_before(np.array(count)))
    skip = np.empty(total, np.int32)
    leaf = np.full(total, -1, np.int32)
    for level, width in enumerate(widths):
        first = np.arange(0, count, width)
        ancestors = sum((first % wider == 0 for wider in widths[level + 1 :]), np.zeros(len(first), np.intp))
        at = nodes_before(first) + ancestors
        skip[at] = nodes_before(np.minimum(first + width, count))
        if level == 0:
            leaf[at] = first
    return skip, leaf
