"""Recursive median split: the order of primitives over which a bounding volume hierarchy is built."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.kernels.compiled import inlined, kernel

_DEEPEST = 128
"""Maximum number of parts on the stack: two for each level of splitting 2^64 points."""


@inlined
def _quickselect(points: NDArray[np.float64], order: NDArray[np.int64], axis: int, low: int, high: int, k: int) -> None:
    """Partially sort `points[low:high]` (n, 3) along `axis`, and `order` with them: no point before index `k` is
    further along it than the one at `k`, and none behind it is less far.

    Hoare, "Algorithm 65: FIND", 1961.
    """
    high -= 1
    while low < high:
        middle = points[k, axis]
        i, j = low, high
        while i <= j:
            while points[i, axis] < middle:
                i += 1
            while middle < points[j, axis]:
                j -= 1
            if i <= j:
                order[i], order[j] = order[j], order[i]
                for c in range(3):
                    points[i, c], points[j, c] = points[j, c], points[i, c]
                i, j = i + 1, j - 1
        if j < k:
            low = i
        if k < i:
            high = j


@kernel
def median_split(points: NDArray[np.float64], branches: int) -> NDArray[np.int64]:
    """The order (n,) of points (n, 3) in which each part is split, recursively, at the median along its longest
    axis-aligned extent, down to parts of at most `branches` points.

    Splits lie at multiples of powers of `branches`, where a tree with that many children per node has its boundaries
    (Samet, "Foundations of Multidimensional and Metric Data Structures", 2006, on k-d trees).
    """
    points, order = points.copy(), np.arange(len(points))  # the copy is sorted too, to be read in sequence
    stack = np.empty((_DEEPEST, 3), np.int64)
    width = 1
    while width * branches < len(points):
        width *= branches
    stack[0, 0], stack[0, 1], stack[0, 2] = 0, len(points), width
    size = 1
    while size > 0:
        size -= 1
        low, high, width = stack[size, 0], stack[size, 1], stack[size, 2]
        if high - low <= branches:
            continue
        while width >= high - low:
            width //= branches
        axis, longest = 0, -1.0
        for k in range(3):
            least = most = points[low, k]
            for i in range(low, high):
                least, most = min(least, points[i, k]), max(most, points[i, k])
            if most - least > longest:
                axis, longest = k, most - least
        half = (-(-(high - low) // width) + 1) // 2 * width
        _quickselect(points, order, axis, low, high, low + half)
        for begin, end in ((low, low + half), (low + half, high)):
            stack[size, 0], stack[size, 1], stack[size, 2] = begin, end, width
            size += 1
    return order
