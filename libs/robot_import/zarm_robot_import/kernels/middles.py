"""Centres of small bounding spheres of points."""

from __future__ import annotations

import numpy as np

from zarm_geometry.kernels.compiled import kernel
from zarm_trajectory.arrays import Array

_STEPS = 14


@kernel
def middles(points: Array) -> Array:
    """The centre (k, m) of a small bounding sphere of each set of points (k, n, m), m <= 3.

    Starts in the middle of the set's bounding box and moves towards the farthest point in ever smaller steps (Badoiu
    and Clarkson, "Smaller core-sets for balls", 2003); returns the best centre met.
    """
    sets, count, size = points.shape
    found = np.empty((sets, size))
    at = np.empty(size)
    for k in range(sets):
        for c in range(size):
            low, high = points[k, 0, c], points[k, 0, c]
            for i in range(count):
                low, high = min(low, points[k, i, c]), max(high, points[k, i, c])
            at[c] = (low + high) / 2
        least = np.inf
        for step in range(2, _STEPS):
            far, which = -1.0, 0
            for i in range(count):
                square = 0.0
                for c in range(size):
                    square += (points[k, i, c] - at[c]) ** 2
                if square > far:
                    far, which = square, i
            better = far < least
            least = min(far, least)
            for c in range(size):
                if better:
                    found[k, c] = at[c]
                at[c] += (points[k, which, c] - at[c]) / (2 * step)
    return found
