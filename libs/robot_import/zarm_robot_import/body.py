"""A link as a solid body: whether a point is inside or outside its surface, and how far."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from zarm_robot_import.kernels.winding import winding
from zarm_robot_import.surface_distance import SurfaceDistance
from zarm_robot_import.triangles import thinned
from zarm_trajectory.arrays import Array

_POINTS = 12_000
_BESIDE = 0.005
"""How far (m) the sample points extend beyond the surface."""
FAR = 0.008
"""Volume at a distance d (m) outside the body costs d^2 (1 + (d / FAR)^2), so that far protrusions weigh more."""
_AROUND = 1000
"""Number of points outside with which shapes are compared."""


@dataclass(frozen=True)
class Body:
    """A link's `shells`, the triangles (k, 3, 3) of each kind of its geometry, together `triangles` (n, 3, 3); and points
    (m, 3) spread over the box around them (Halton points, since those of a grid lie in planes).

    For these, `distance` (m,) to the surface, and whether they are `out` (m,) of it; each represents a volume of `cell`
    (m^3). `surface` gives distances to the surface; the link's true one may be `off` (m) from it. Few triangles (j, 3, 3)
    close to those of each shell, `coarse`, decide what is inside.
    """

    shells: tuple[Array, ...]
    coarse: list[Array]
    triangles: Array
    points: Array
    distance: Array
    out: NDArray[np.bool_]
    cell: float
    surface: SurfaceDistance
    off: float

    @classmethod
    def of(cls, *shells: Array, off: float = 0.0) -> Self:
        """From the triangles (n, 3, 3) of each kind of geometry."""
        triangles = np.concatenate(shells)
        coarse = [thinned(shell) for shell in shells]
        surface = SurfaceDistance(triangles)
        lower, upper = triangles.min(axis=(0, 1)) - _BESIDE, triangles.max(axis=(0, 1)) + _BESIDE
        points = qmc.scale(qmc.Halton(3, scramble=False).random(_POINTS), lower, upper)
        cell = float((upper - lower).prod() / len(points))
        return cls(shells, coarse, triangles, points, surface.of(points), ~_inside(points, coarse), cell, surface, off)

    def inside(self, points: Array) -> NDArray[np.bool_]:
        """Which points (n, 3) are inside: those around which one kind of geometry winds, or all together.

        If the surface is open, what it mostly winds around counts as inside. One kind is enough because collision and
        visual meshes may be wound in opposite directions; all together, because one may close the other.
        """
        return _inside(points, self.coarse)

    def around(self, points: Array) -> tuple[Array, Array]:
        """Points (n, 3) outside the body in the box around `points` (k, 3), slightly enlarged, and the cost of each:
        that of its distance (n,) (see FAR) times its volume, the largest first.
        """
        low, high = points.min(axis=0), points.max(axis=0)
        more = 0.2 * (high - low).max()
        near = np.flatnonzero(
            self.out & (self.points > low - more).all(axis=1) & (self.points < high + more).all(axis=1)
        )
        some = near[:: 1 + len(near) // _AROUND]
        some = some[np.argsort(-self.distance[some])]
        cost = self.distance[some] ** 2 * (1 + (self.distance[some] / FAR) ** 2)
        return self.points[some], cost * (self.cell * len(near) / max(len(some), 1))


def _inside(points: Array, shells: Sequence[Array]) -> NDArray[np.bool_]:
    each = np.array([winding(points, shell) for shell in shells])
    found: NDArray[np.bool_] = np.abs([*each, each.sum(axis=0)]).max(axis=0) > 0.5
    return found
