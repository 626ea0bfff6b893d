"""How far points are from the surface of a link."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from zarm_robot_import.kernels.surface_distance import least_distances
from zarm_robot_import.kernels.winding import winding
from zarm_robot_import.triangles import points_on
from zarm_trajectory.arrays import Array

_POINTS = 20_000
"""Points that are spread over the triangles, ..."""
_NEAREST = 4
"""... and the number of nearest ones whose triangles are measured."""
_SEARCH_POINTS = 2000
"""Points in the search for what sticks out."""


class SurfaceDistance:
    """Distances to triangles (m, 3, 3): to those of the few nearest of many points on them, which is exact but for where
    the nearest triangle has none of these; there it is an upper bound.

    These points are the triangles' corners, and `spread` (j, 3), which are spread evenly.
    """

    def __init__(self, triangles: Array) -> None:
        spread, which = points_on(triangles, _POINTS)
        corners, first = np.unique(triangles.reshape(-1, 3), axis=0, return_index=True)
        self.spread = spread
        self._triangles = triangles
        self._tree = cKDTree(np.concatenate([spread, corners]))
        self._triangle = np.concatenate([which, first // 3])

    def of(self, points: Array) -> Array:
        """The distances (n,) in m of points (n, 3)."""
        _, nearest = self._tree.query(points, _NEAREST)
        return least_distances(points, self._triangles, self._triangle[nearest])


def sticks_out(inner: Array, outer: Array, least: float) -> float:
    """How far (m) the farthest of many points on the triangles `inner` is outside the surface `outer`; 0 if none is by
    more than `least` (m).
    """
    points = points_on(inner, _SEARCH_POINTS)[0]
    bound = SurfaceDistance(outer).of(points)
    far = bound > least
    points, bound = points[far], bound[far]
    outside = np.abs(winding(points, outer)) < 0.5
    everything = np.arange(len(outer))[None]
    farthest = least
    for i in np.argsort(-bound):
        if bound[i] <= farthest:
            break
        if outside[i]:
            farthest = max(farthest, float(least_distances(points[i : i + 1], outer, everything)[0]))
    return farthest if farthest > least else 0.0
