"""A cell: a piece of a link's surface, and the tightest primitive around it.

A convex primitive contains a piece of surface if it contains the corners of its triangles, so containment is exact.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from zarm_geometry.packed_shapes import bounds
from zarm_robot_import.body import Body
from zarm_robot_import.directions import axes_of
from zarm_robot_import.kernels.enclosing import around, oriented
from zarm_robot_import.kernels.middles import middles
from zarm_robot_import.kernels.outside import least_outside
from zarm_robot_import.primitives import grown, volumes
from zarm_robot_import.triangles import points_on
from zarm_trajectory.arrays import Array

Box = tuple[list[float], list[float]]
"""The lower and upper corner (3,) of a box, in m."""

_POINTS = 250
"""Points that represent the surface in the search for planes."""
_TOUCHING = 0.001
"""Boxes this close (m) to each other touch."""
_FLAT = 0.002
"""All volume counts as if it were at least this far (m) outside, because thin shapes fit between the body's points."""


@dataclass(eq=False)
class Cell:
    """The content between planes: triangles (n, 3, 3), their distinct vertices (j, 3), the corners (k, 3) of their convex
    hull, points (m, 3) on them, and the row of the enclosing primitive; `out` as in `tightest`.

    `axes` (l, 3, 3) are the frames to try here. `final` if no plane makes it tighter.
    """

    triangles: Array
    vertices: Array
    corners: Array
    points: Array
    axes: Array
    row: Array
    out: float
    final: bool = False

    @cached_property
    def box(self) -> Box:
        """The box around its triangles."""
        return self.corners.min(axis=0).tolist(), self.corners.max(axis=0).tolist()

    @cached_property
    def extent(self) -> Box:
        """The box around its primitive."""
        lower, upper = bounds(self.row[None])
        return lower[0].tolist(), upper[0].tolist()


def piece(triangles: Array, vertices: Array, axes: Array, body: Body) -> Cell:
    """A cell of some of the triangles, whose vertices are these."""
    corners = _hull(vertices)
    along = corners @ axes[:, :, 2].T
    furthest = np.unique(np.concatenate([along.argmin(axis=0), along.argmax(axis=0)]))
    points = np.concatenate([points_on(triangles, _POINTS)[0], corners[furthest]])
    return _cell(triangles, vertices, corners, points, axes_of(points, triangles, axes), body)


def union(a: Cell, b: Cell, axes: Array, body: Body) -> Cell:
    """Two cells merged."""
    return _cell(
        np.concatenate([a.triangles, b.triangles]),
        np.concatenate([a.vertices, b.vertices]),
        np.concatenate([a.corners, b.corners]),
        np.concatenate([a.points[::2], b.points[::2]]),
        np.concatenate([a.axes, b.axes[len(axes) :]]),
        body,
    )


def touch(a: Box, b: Box) -> bool:
    """Whether two boxes touch."""
    (low, high), (other_low, other_high) = a, b
    return all(low[i] <= other_high[i] + _TOUCHING and other_low[i] <= high[i] + _TOUCHING for i in range(3))


def _hull(points: Array) -> Array:
    """The corners (k, 3) of the convex hull of points (n, 3); all points if they are coplanar."""
    found: Array
    try:
        found = points[ConvexHull(points).vertices]
    except QhullError:
        found = np.unique(points, axis=0)
    return found


def _cell(triangles: Array, vertices: Array, corners: Array, points: Array, axes: Array, body: Body) -> Cell:
    form = form_of(points, axes)
    which, out = tightest(points, form, body.around(points))
    one = [which % len(axes)]
    shapes = around(corners, form.turn[one], form.box[one], form.axis[one], form.middle)
    return Cell(triangles, vertices, corners, points, axes, grown(shapes[which // len(axes)], body.off), out)


class _Form(NamedTuple):
    """The known part of primitives, without their sizes: frames (n, 3, 3) of round ones with z along them, and of
    boxes; a point (n, 3) on the axis; the centre (3,) of a ball.
    """

    turn: Array
    box: Array
    axis: Array
    middle: Array


def form_of(points: Array, axes: Array) -> _Form:
    """The form of primitives around points (m, 3) in the frames `axes` (n, 3, 3)."""
    return _Form(axes, *oriented(points, axes), middles(points[None])[0])


def tightest(points: Array, form: _Form, outer: tuple[Array, Array], most: float = np.inf) -> tuple[int, float]:
    """The primitive around points with the least cost outside the body: its index and cost; -1 and `most` if all cost
    more.

    `outer` are points outside, and the cost of each. The cost is the integral over the primitive of that of the
    distance to the body, in m^5.
    """
    rows = around(points, *form)
    return least_outside(rows, _FLAT**2 * volumes(rows), *outer, most)
