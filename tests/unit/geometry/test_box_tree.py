"""Trees of boxes over the shapes of a world."""

from __future__ import annotations

import numpy as np
import pytest

from zarm_geometry import packed_shapes
from zarm_geometry.box_tree import BoxTree, joined
from zarm_geometry.kernels.arrays import WorldArrays


@pytest.mark.parametrize("count", [0, 1, 2, 5, 17, 200])
def test_joined_trees_hold_each_shape_once(count: int) -> None:
    rng = np.random.default_rng(count)
    trees = [tree(rng, int(rng.integers(0, 12))) for _ in range(count)] + [tree(rng, 0)]
    arrays = joined(trees, 0.0)
    assert sorted(leaves(arrays, 0, len(arrays.skip), None)) == list(range(len(arrays.shapes)))


def test_a_single_tree_stays_as_it_is() -> None:
    alone = tree(np.random.default_rng(0), 50)
    arrays = joined([alone, tree(np.random.default_rng(0), 0)], 0.0)
    assert np.array_equal(arrays.skip, alone.skip)
    assert np.array_equal(arrays.leaf, alone.leaf)


def tree(rng: np.random.Generator, count: int) -> BoxTree:
    """Small boxes about a random place."""
    lower = rng.uniform(-1.0, 1.0, 3) + rng.uniform(-0.1, 0.1, (count, 3))
    return BoxTree.over(packed_shapes.boxes(lower, lower + 0.05))


def leaves(arrays: WorldArrays, first: int, last: int, around: np.ndarray | None) -> list[int]:
    """The shapes below these nodes, each of which lies in the box `around` them."""
    found = []
    node = first
    while node < last:
        box = arrays.boxes[node]
        if around is not None:
            assert np.all(np.abs(box[:3] - around[:3]) <= around[3:] - box[3:] + 1e-6)
        if arrays.leaf[node] < 0:
            found += leaves(arrays, node + 1, arrays.skip[node], box)
        else:
            found.append(int(arrays.leaf[node]))
        node = arrays.skip[node]
    return found
