"""Trees of axis-aligned boxes over convex shapes."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from zarm_geometry import packed_shapes
from zarm_geometry.allowed_collisions import EVERY_LINK
from zarm_geometry.kernels.arrays import WorldArrays
from zarm_geometry.kernels.median_split import median_split
from zarm_geometry.kernels.refit import centers, refit
from zarm_trajectory.arrays import Array, Index

BRANCHES = 4
"""Children per node."""


class BoxTree(NamedTuple):
    """Shapes and the boxes around them.

    `rows` (n, 17) are the shapes as in `zarm_geometry.packed_shapes`, in the order of the tree, and `order` (n,) their original
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
    counts = np.array([len(tree.skip) for tree in trees])
    shape_counts = np.array([len(tree.rows) for tree in trees])
    first_node, first_shape = np.cumsum(counts) - counts, np.cumsum(shape_counts) - shape_counts
    boxes = np.concatenate([tree.boxes for tree in trees])
    filled = np.flatnonzero(counts)
    lower = np.minimum.reduceat(boxes[:, :3] - boxes[:, 3:], first_node[filled])
    upper = np.maximum.reduceat(boxes[:, :3] + boxes[:, 3:], first_node[filled])
    top = BoxTree.over(packed_shapes.boxes(lower, upper))
    # The nodes of a tree come after its leaf in `top`, or in the place of that if they have one root, or there is no other tree.
    is_leaf = top.leaf >= 0
    tree_of_leaf = filled[top.order[top.leaf[is_leaf]]]
    kept = ~is_leaf
    kept[is_leaf] = [len(filled) > 1 and trees[index].skip[0] != counts[index] for index in tree_of_leaf]
    sizes = kept.astype(np.intp)
    sizes[is_leaf] += counts[tree_of_leaf]
    new_place = np.concatenate([[0], np.cumsum(sizes)])
    new_first = np.zeros(len(trees), np.intp)
    new_first[tree_of_leaf] = new_place[1:][is_leaf] - counts[tree_of_leaf]
    owner = np.repeat(np.arange(len(trees)), counts)
    of_top, of_trees = new_place[:-1][kept], np.arange(len(owner)) + (new_first - first_node)[owner]
    skip, leaf = np.concatenate([tree.skip for tree in trees]), np.concatenate([tree.leaf for tree in trees])
    arrays = WorldArrays(
        np.concatenate([tree.rows for tree in trees], dtype=np.float32, casting="same_kind"),
        np.empty((new_place[-1], 6), np.float32),
        np.empty(new_place[-1], np.int32),
        np.empty(new_place[-1], np.int32),
        np.full(shape_counts.sum(), EVERY_LINK),
        margin,
    )
    arrays.boxes[of_top], arrays.boxes[of_trees] = top.boxes[kept], boxes
    arrays.skip[of_top], arrays.skip[of_trees] = new_place[top.skip[kept]], skip + new_first[owner]
    arrays.leaf[of_top], arrays.leaf[of_trees] = -1, np.where(leaf < 0, leaf, leaf + first_shape[owner])
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
