"""The order that bounding volume hierarchies are built in: a permutation in which a plane parts the halves of every node."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from zarm_geometry.kernels.median_split import median_split

BRANCHES = 4


def _points(kind: str, count: int) -> NDArray[np.float64]:
    if kind == "equal":
        return np.zeros((count, 3))
    if kind == "grid":
        side = int(np.ceil(count ** (1 / 3)))
        return np.argwhere(np.ones((side, side, side)))[:count].astype(float, order="C")
    return np.random.default_rng(count).normal(size=(count, 3))


@pytest.mark.parametrize("kind", ["random", "grid", "equal"])
@pytest.mark.parametrize("count", [0, 1, 4, 5, 63, 64, 65, 3000])
def test_every_point_is_kept_and_a_plane_parts_each_node(kind: str, count: int) -> None:
    points = _points(kind, count)
    order = median_split(points, BRANCHES)
    assert sorted(order.tolist()) == list(range(count))
    sorted_points = points[order]
    for width in BRANCHES ** np.arange(1, 7):  # within the smallest nodes any order will do
        for low in range(0, count, width * BRANCHES):
            node = sorted_points[low : low + width * BRANCHES]
            half = (-(-len(node) // width) + 1) // 2 * width
            if half < len(node):
                assert (node[:half].max(axis=0) <= node[half:].min(axis=0)).any()
