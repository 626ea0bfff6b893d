"""How far primitives protrude from a link."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from zarm_robot_import.body import FAR, Body
from zarm_robot_import.kernels.outside import within
from zarm_robot_import.primitives import triangles_of
from zarm_robot_import.triangles import areas, points_on
from zarm_trajectory.arrays import Array

MEAN, MOST = 0.004, 0.012
"""How far (m) the primitives of a link may protrude on average, and at most: tighter ones are not looked for, ..."""
_LARGE = 0.15
"""... unless the link is smaller than this (m): then they may by as much less, since fingers reach into narrow places."""
_SAMPLES = 400
"""Points on each primitive at which it is measured."""
_FIRST_STRIDE = 10
"""One of so many of them is measured first."""


@dataclass(frozen=True)
class Out:
    """How far (m) the outside of a primitive is from the body: at most, and integrated over its `area` (m^2)."""

    most: float
    total: float
    area: float

    @property
    def mean(self) -> float:
        """The mean distance (m)."""
        return self.total / self.area if self.area else 0.0

    @classmethod
    def together(cls, outs: Sequence[Self]) -> Self:
        """Several primitives combined."""
        return cls(max(out.most for out in outs), sum(out.total for out in outs), sum(out.area for out in outs))


@dataclass(frozen=True)
class Goal:
    """How far (m) the primitives of a link may protrude, on average and at most."""

    mean: float
    most: float

    @classmethod
    def of(cls, body: Body) -> Self:
        """The goal for a link, by its size."""
        share = min(float(np.ptp(body.triangles, axis=(0, 1)).max()) / _LARGE, 1.0)
        return cls(share * MEAN, share * MOST)

    def excess(self, out: Out) -> float:
        """How many times as far something protrudes; at most 1 if the goal is met."""
        return max(out.mean / self.mean, out.most / self.most)


class Measure:
    """How far primitives protrude from a body."""

    def __init__(self, body: Body) -> None:
        self._body = body
        self.goal = Goal.of(body)
        self._known: dict[bytes, _Skin] = {}

    def all(self, rows: Array) -> Out:
        """For all primitives (n, 17) of the body."""
        return Out.together([self.one(row, np.delete(rows, i, axis=0)) for i, row in enumerate(rows)])

    def one(self, row: Array, others: Array, most: float = np.inf) -> Out:
        """For one primitive (17,), without the parts inside the body or one of `others` (n, 17); sampled, so an upper
        bound. If it protrudes further than `most` (m), the answer says no more than that.
        """
        if row.tobytes() not in self._known and (far := self._few(row, others)) > most:
            return Out(far, 0.0, 0.0)
        skin = self._skin(row)
        outer = np.flatnonzero(~within(skin.points, others, 1e-5))
        # Whether a point is within the body takes the longest to tell: first of those that decide.
        self._decide_inside(skin, outer[skin.out[outer] > most])
        if skin.out[outer].max(initial=0.0) <= most:
            self._decide_inside(skin, outer)
        out = skin.out[outer]
        return Out(float(out.max(initial=0.0)), skin.each * float(out.sum()), skin.each * len(out))

    def _few(self, row: Array, others: Array) -> float:
        """How far (m) the farthest of a few of the points on a primitive protrudes: enough to reject most that protrude too far."""
        points = points_on(triangles_of(row), _SAMPLES)[0][::_FIRST_STRIDE]
        points = points[~within(points, others, 1e-5)]
        out = self._body.surface.of(points)
        unsure = out > self.goal.mean
        return float(out[unsure][~self._body.inside(points[unsure])].max(initial=0.0))

    def _decide_inside(self, skin: _Skin, some: NDArray[np.intp]) -> None:
        """Decide which of these points are within the body."""
        unsure = some[skin.unsure[some]]
        skin.out[unsure[self._body.inside(skin.points[unsure])]] = 0.0
        skin.unsure[unsure] = False

    def outside(self, row: Array) -> tuple[Array, Array]:
        """Points (n, 3) on a primitive (17,) outside the body, and for each the integral (n,) of the distance cost over
        the volume below it, in m^5: for thin primitives, which contain too few of the body's points.
        """
        self.one(row, np.empty((0, 17)))
        skin = self._skin(row)
        out = skin.out > 0.0
        depth = skin.out[out]
        return skin.points[out], skin.each * (depth**3 / 3 + depth**5 / (5 * FAR**2))

    def _skin(self, row: Array) -> _Skin:
        if (key := row.tobytes()) not in self._known:
            triangles = triangles_of(row)
            points = points_on(triangles, _SAMPLES)[0]
            out = self._body.surface.of(points)
            self._known[key] = _Skin(points, out, out > self.goal.mean, float(areas(triangles).sum()) / len(points))
        return self._known[key]


@dataclass(frozen=True)
class _Skin:
    """Points (n, 3) on a primitive, their distances (n,) from the body, and a mask `unsure` (n,) of those that may be
    inside; each represents an area of `each` (m^2).
    """

    points: Array
    out: Array
    unsure: NDArray[np.bool_]
    each: float
