"""The sphere cover of a robot: balls that contain the exact geometry of its links, which the search computes with.

A ball around a point within a body, `depth` below its surface, with a radius of `depth` + d stands out of the body by no more
than d. So for each d the fewest such balls that contain the geometry are looked for, as a set cover, greedily; and d is as small as
a number of balls allows. What they contain is then proven and not sampled: `kernels.balls` grows them until nothing is outside.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from zarm_geometry.rows import distances
from zarm_robot_import.kernels.balls import around_shapes
from zarm_robot_import.meshes import areas, points_on
from zarm_robot_import.primitives import triangles_of

Array = NDArray[np.float64]

BUDGET = 80
"""Balls in the cover of the whole robot."""
_POINTS = 1200
_CELLS = 4000
_ROUNDS = 3
_STEPS = (0.008,) * 3 + (0.004,) * 3 + (0.002,) * 3 + (0.001,) * 3
_AROUND = np.array([(x, y, z) for x in (0, 1, -1) for y in (0, 1, -1) for z in (0, 1, -1)], float)
_FINEST = 5e-4
"""What the proof cuts no further (m)."""


@dataclass(frozen=True)
class _Problem:
    """Points (n, 3) to contain, places (m, 4) for balls with the depth of each, and what each lacks of each point: `lack` (n, m).

    `rows` (k, 17) are the exact geometry below whose surface the depth is.
    """

    points: Array
    places: Array
    lack: NDArray[np.float32]
    rows: Array

    @classmethod
    def of(cls, rows: Array) -> Self:
        """Of a link whose exact geometry are `rows` (n, 17)."""
        points = outer_points(rows, _POINTS)
        grid = np.concatenate([_within(row, _CELLS // len(rows)) for row in rows])
        deep = depths(grid, rows)
        places = np.column_stack((grid, deep))[deep > 0.0]
        points = np.concatenate([points, places[:: 1 + len(places) // _POINTS, :3]])
        lack = (cdist(points, places[:, :3]) - places[:, 3]).astype(np.float32)
        return cls(points, places, lack, rows)


def _within(row: Array, count: int) -> Array:
    """About `count` points (n, 3) of a grid over the box around a shape (17,), along its axes: thin ones have some, too."""
    half = row[12:15] + row[16] + (row[15], row[15], 0.0)
    frame = row[:12].reshape(3, 4)
    found: Array = (_grid(-half, half, count) - frame[:, 3]) @ frame[:, :3]
    return found


def _grid(lower: Array, upper: Array, count: int) -> Array:
    """About `count` points (n, 3) of a grid over a box."""
    size = np.maximum(upper - lower, 1e-3)
    step = float((size.prod() / count) ** (1 / 3))
    axes = [np.linspace(a, b, max(3, round((b - a) / step))) for a, b in zip(lower, upper, strict=True)]
    found: Array = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return found


def depths(points: Array, rows: Array) -> Array:
    """How far (n,) points are at least below the surface of the union of shapes (m, 17); not above 0 outside."""
    found: Array = -distances(points, rows).min(axis=1)
    return found


def fit_covers(rows: Mapping[str, Array], budget: int = BUDGET) -> dict[str, Array]:
    """Balls (n, 4) of each link, as the descriptor has them, that contain its exact geometry (m, 17).

    They are `budget` in all, at least one each, and stand out equally far as far as they can.
    """
    problems = {link: _Problem.of(table) for link, table in rows.items()}
    return {
        link: _written(around_shapes(_rounded(_placed(problems[link], places)), rows[link], _FINEST))
        for link, places in _at_most(problems, max(budget, len(rows))).items()
    }


def ball_rows(balls: Array) -> Array:
    """Balls (n, 4) as rows (n, 17) of `zarm_geometry.rows`."""
    rows = np.zeros((len(balls), 17))
    rows[:, [0, 5, 10]] = 1.0
    rows[:, [3, 7, 11]] = -balls[:, :3]
    rows[:, 16] = balls[:, 3]
    return rows


def outer_points(rows: Array, count: int) -> Array:
    """About `count` points (n, 3) on the boundary of the union of shapes (m, 17)."""
    surfaces = [triangles_of(row) for row in rows]
    sizes = np.array([areas(surface).sum() for surface in surfaces])
    counts = np.maximum(np.round(count * sizes / sizes.sum()).astype(int), 40)
    found = []
    for i, (surface, number) in enumerate(zip(surfaces, counts.tolist(), strict=True)):
        corners = np.unique(surface.reshape(-1, 3), axis=0) if number < 400 else np.empty((0, 3))
        points = np.concatenate([points_on(surface, number)[0], corners])
        others = np.delete(rows, i, axis=0)
        found.append(points[distances(points, others).min(axis=1, initial=np.inf) > -1e-6])
    return np.concatenate(found)


def _fewest(problem: _Problem, out: float) -> list[int]:
    """Places of few balls that stand out by no more than `out` and contain all points that any such ball contains."""
    covers = problem.lack <= out
    left = covers.any(axis=1)
    gains = covers[left].sum(axis=0)
    chosen: list[int] = []
    while left.any():
        chosen.append(int(np.argmax(gains)))
        new = left & covers[:, chosen[-1]]
        gains -= covers[new].sum(axis=0)
        left &= ~new
    return chosen


def _placed(problem: _Problem, chosen: list[int]) -> Array:
    """As many balls (n, 4) or fewer, moved so that they stand out less, and no larger than that asks for.

    As in k-means, each point goes to the ball that lacks the least of it, and each ball to where it stands out least.
    """
    places = np.array(chosen)
    for _ in range(_ROUNDS):
        owner = np.argmin(problem.lack[:, places], axis=1)
        moved = np.array([int(np.argmin(problem.lack[owner == i].max(axis=0))) for i in np.unique(owner)])
        if len(moved) == len(places) and (moved == places).all():
            break
        places = moved
    return _settled(problem, problem.places[places])


def _settled(problem: _Problem, places: Array) -> Array:
    """Balls (n, 4) from places (n, 4), moved off the grid; each step stays within the body, as long as its depth."""
    for step in _STEPS:
        lack = cdist(places[:, :3], problem.points) - places[:, 3:]
        owner = np.argmin(lack, axis=0)
        places = places[np.unique(owner)]
        tried = (places[:, None, :3] + step * _AROUND).reshape(-1, 3)
        depth = depths(tried, problem.rows).reshape(len(places), -1)
        for i, mine in enumerate(np.unique(owner)):
            points = problem.points[owner == mine]
            out = (cdist(tried.reshape(len(places), -1, 3)[i], points) - depth[i][:, None]).max(axis=1)
            out[1:][depth[i][1:] < 0.0] = np.inf
            best = int(np.argmin(out))
            if out[best] < out[0] - 1e-5:
                places[i] = (*tried.reshape(len(places), -1, 3)[i, best], depth[i, best])
    lack = cdist(places[:, :3], problem.points) - places[:, 3:]
    owner = np.argmin(lack, axis=0)
    kept = np.unique(owner)
    radii = [float(max(places[i, 3] + lack[i, owner == i].max(), 1e-4)) for i in kept]
    return np.column_stack((places[kept, :3], radii))


def _at_most(problems: Mapping[str, _Problem], count: int) -> dict[str, list[int]]:
    """Places for balls in each, `count` at most in all, that stand out as little as that allows."""

    def tried(out: float) -> dict[str, list[int]]:
        return {link: _fewest(problem, out) for link, problem in problems.items()}

    low, high = 0.0, 0.1
    while _count(chosen := tried(high)) > count and high < 10.0:
        low, high = high, 2 * high
    while high - low > 1e-3:
        middle = (low + high) / 2
        if _count(more := tried(middle)) <= count:
            chosen, high = more, middle
        else:
            low = middle
    return chosen


def _count(places: Mapping[str, list[int]]) -> int:
    return sum(map(len, places.values()))


def _rounded(balls: Array) -> Array:
    return np.column_stack((np.round(balls[:, :3], 4), balls[:, 3]))


def _written(balls: Array) -> Array:
    return np.column_stack((balls[:, :3], np.ceil(balls[:, 3] * 1e4 - 1e-6) / 1e4 + 0.0))
