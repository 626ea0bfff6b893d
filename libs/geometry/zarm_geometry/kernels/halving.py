"""The order in which a tree of boxes over points is built: neighbours in it are neighbours in space."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.kernels.compiled import inlined, kernel

_DEEPEST = 128
"""Parts that wait to be halved, at most: two for each halving of 2^64 points."""


@inlined
def _part(order: NDArray[np.int64], along: NDArray[np.float64], low: int, high: int, k: int) -> None:
    """Reorder `order[low:high]` so that what lies before its place `k` is not further `along`, and what lies behind not less far.

    Hoare, "Algorithm 65: FIND", 1961.
    """
    high -= 1
    while low < high:
        middle = along[order[k]]
        i, j = low, high
        while i <= j:
            while along[order[i]] < middle:
                i += 1
            while middle < along[order[j]]:
                j -= 1
            if i <= j:
                order[i], order[j] = order[j], order[i]
                i, j = i + 1, j - 1
        if j < k:
            low = i
        if k < i:
            high = j


@kernel
def halved(points: NDArray[np.float64], branches: int) -> NDArray[np.int64]:
    """The order (n,) of points (n, 3) after they were halved again and again across the longest extent of each part, at the median.

    The borders of parts lie at multiples of powers of `branches`, as those of a tree's nodes do whose children are that many (Samet,
    "Foundations of Multidimensional and Metric Data Structures", 2006, on k-d trees).
    """
    order = np.arange(len(points))
    waiting = np.empty((_DEEPEST, 3), np.int64)
    width = 1
    while width * branches < len(points):
        width *= branches
    waiting[0, 0], waiting[0, 1], waiting[0, 2] = 0, len(points), width
    count = 1
    while count > 0:
        count -= 1
        low, high, width = waiting[count, 0], waiting[count, 1], waiting[count, 2]
        while width > 1 and width >= high - low:
            width //= branches
        children = -(-(high - low) // width)
        if children < 2:
            continue
        axis, longest = 0, -1.0
        for k in range(3):
            least = most = points[order[low], k]
            for i in range(low, high):
                least, most = min(least, points[order[i], k]), max(most, points[order[i], k])
            if most - least > longest:
                axis, longest = k, most - least
        half = (children + 1) // 2 * width
        _part(order, points[:, axis], low, high, low + half)
        for begin, end in ((low, low + half), (low + half, high)):
            waiting[count, 0], waiting[count, 1], waiting[count, 2] = begin, end, width
            count += 1
    return order
