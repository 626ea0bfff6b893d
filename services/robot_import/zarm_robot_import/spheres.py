"""Spheres around each link: many as its exact geometry, fewer as the cover that the search uses.

A ball around a point within a body, `depth` below its surface, with a radius of `depth` + d stands out of the body by no more
than d. So for each d the fewest such balls that contain the surface are looked for, as a set cover, greedily; and d is as small as
a number of balls allows. What they contain is then proven and not sampled: `kernels.balls` grows them until nothing is outside.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from zarm_robot_import.kernels.balls import around_balls, around_triangles
from zarm_robot_import.kernels.winding import winding
from zarm_robot_import.meshes import Surface, points_on

Array = NDArray[np.float64]

EXACT = 0.004
"""How far the exact geometry may stand out of a link (m), before the proof lets it grow ..."""
MOST_EXACT = 40
"""... unless that takes more balls than this for one link."""
BUDGET = 80
"""Balls in the cover of the whole robot."""
_POINTS = 2500
_CELLS = 5000
_WOUND = 700
"""Triangles by which it is told what is inside."""
_ROUNDS = 3
_STEPS = (0.008,) * 3 + (0.004,) * 3 + (0.002,) * 3 + (0.001,) * 3
_AROUND = np.array([(x, y, z) for x in (0, 1, -1) for y in (0, 1, -1) for z in (0, 1, -1)], float)
_FINEST = 5e-4
"""What the proof cuts no further (m)."""


@dataclass(frozen=True)
class Balls:
    """Balls (n, 4), x, y, z and radius in the link's frame, as the descriptor writes them; they contain the link's surface.

    `mean` and `most` (m): how far their boundary is from it.
    """

    balls: Array
    mean: float
    most: float


@dataclass(frozen=True)
class Fitted:
    """The exact geometry of a link, and the cover that contains it."""

    link: str
    exact: Balls
    cover: Balls


@dataclass(frozen=True)
class _Problem:
    """Points (n, 3) to contain, places (m, 4) for balls with the depth of each, and what each lacks of each point (m, n).

    `surface` are points of the surface below which the depth is.
    """

    points: Array
    places: Array
    lack: NDArray[np.float32]
    surface: cKDTree

    @classmethod
    def of(cls, points: Array, places: Array, surface: cKDTree) -> Self:
        return cls(points, places, (cdist(places[:, :3], points) - places[:, 3:]).astype(np.float32), surface)


def fit(
    surfaces: Sequence[Surface], budget: int = BUDGET, done: Callable[[str], None] = lambda link: None
) -> list[Fitted]:
    """Exact geometry and covers of all links; `budget` balls in all covers, at least one each."""
    exact: list[Array] = []
    problems: list[_Problem] = []
    for surface in surfaces:
        problem = _of_surface(surface.triangles)
        places = _fewest(problem, EXACT)
        if len(places) > MOST_EXACT:
            places = _at_most([problem], MOST_EXACT)[0]
        # Large triangles first: they leave less for the small ones to cut.
        sides = np.linalg.norm(np.diff(surface.triangles, axis=1), axis=2).max(axis=1)
        exact.append(
            _written(
                around_triangles(_rounded(_placed(problem, places)), surface.triangles[np.argsort(-sides)], _FINEST)[0]
            )
        )
        problems.append(_around(problem, exact[-1]))
        done(surface.link)
    covers = [
        _placed(problem, chosen)
        for problem, chosen in zip(problems, _at_most(problems, max(budget, len(surfaces))), strict=True)
    ]
    found = []
    for surface, inner, chosen in zip(surfaces, exact, covers, strict=True):
        outer = inner if len(chosen) >= len(inner) else _written(around_balls(_rounded(chosen), inner, _FINEST)[0])
        found.append(
            Fitted(surface.link, *(Balls(balls, *stands_out(balls, surface.triangles)) for balls in (inner, outer)))
        )
    return found


def stands_out(balls: Array, triangles: Array) -> tuple[float, float]:
    """How far (m) the boundary of balls is from a surface that they contain: on average, and at most; sampled, so from above."""
    points, weight, _ = boundary(balls, 300)
    cloud = np.concatenate([points_on(triangles, 20_000)[0], triangles.reshape(-1, 3)[:100_000]])
    distance = cKDTree(cloud).query(points)[0]
    return float(np.average(distance, weights=weight)), float(distance.max())


def _of_surface(triangles: Array) -> _Problem:
    points = np.concatenate([points_on(triangles, _POINTS)[0], _extremes(triangles)])
    cloud = cKDTree(points_on(triangles, 20_000)[0])
    grid = _grid(points)
    coarse = thinned(triangles, _WOUND)
    inside = grid[np.abs(winding(grid, coarse)) > 0.5]
    depth = cloud.query(inside)[0] if len(inside) else np.empty(0)
    # Places on the surface, too: thin plates have no inside to speak of, and open ones have none.
    some = points[::12]
    places = np.concatenate([np.column_stack((inside, depth)), np.column_stack((some, np.zeros(len(some))))])
    return _Problem.of(points, places, cloud)


def _around(inner: _Problem, balls: Array) -> _Problem:
    """The same for balls around that link."""
    points = boundary(balls, max(60, 3 * _POINTS // len(balls)))[0]
    return _Problem.of(points[:: max(1, len(points) // _POINTS)], inner.places, inner.surface)


def _fewest(problem: _Problem, out: float) -> list[int]:
    """Places of few balls that stand out by no more than `out` and contain all points that any such ball contains."""
    covers = problem.lack <= out
    left = covers.any(axis=0)
    gains = covers.sum(axis=1)
    chosen: list[int] = []
    while left.any():
        chosen.append(int(np.argmax(gains)))
        new = left & covers[chosen[-1]]
        gains -= covers[:, new].sum(axis=1)
        left &= ~new
    return chosen


def _placed(problem: _Problem, chosen: list[int]) -> Array:
    """As many balls (n, 4) or fewer, moved so that they stand out less, and no larger than that asks for.

    As in k-means, each point goes to the ball that lacks the least of it, and each ball to where it stands out least.
    """
    places = np.array(chosen)
    for _ in range(_ROUNDS):
        owner = np.argmin(problem.lack[places], axis=0)
        moved = np.array([int(np.argmin(problem.lack[:, owner == i].max(axis=1))) for i in np.unique(owner)])
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
        depth = problem.surface.query(tried)[0].reshape(len(places), -1)
        for i, mine in enumerate(np.unique(owner)):
            points = problem.points[owner == mine]
            out = (cdist(tried.reshape(len(places), -1, 3)[i], points) - depth[i][:, None]).max(axis=1)
            if places[i, 3] < 1.8 * step:  # what is this near to the surface may be outside after a step
                out[1:] = np.inf
            best = int(np.argmin(out))
            if out[best] < out[0] - 1e-5:
                places[i] = (*tried.reshape(len(places), -1, 3)[i, best], depth[i, best])
    lack = cdist(places[:, :3], problem.points) - places[:, 3:]
    owner = np.argmin(lack, axis=0)
    kept = np.unique(owner)
    radii = [float(max(places[i, 3] + lack[i, owner == i].max(), 1e-4)) for i in kept]
    return np.column_stack((places[kept, :3], radii))


def _at_most(problems: Sequence[_Problem], count: int) -> list[list[int]]:
    """Places for balls in each, `count` at most in all, that stand out equally far and as little as that allows."""
    low, high = 0.0, 0.1
    while True:
        found = [_fewest(problem, high) for problem in problems]
        if sum(map(len, found)) <= count or high > 10.0:
            break
        low, high = high, 2 * high
    while high - low > 5e-4:
        middle = (low + high) / 2
        tried = [_fewest(problem, middle) for problem in problems]
        if sum(map(len, tried)) <= count:
            found, high = tried, middle
        else:
            low = middle
    return found


def thinned(triangles: Array, most: int) -> Array:
    """At most `most` triangles near to these, whose corners are gathered in cells."""
    size = max(float(np.ptp(triangles.reshape(-1, 3), axis=0).max()) / 200, 1e-5)
    given = triangles
    while len(triangles) > most:
        cells = np.round(given / size).astype(np.int64)
        a, b, c = cells.transpose(1, 0, 2)
        kept = (a != b).any(axis=1) & (b != c).any(axis=1) & (c != a).any(axis=1)
        triangles = cells[kept] * size
        size *= 1.4
    return triangles


def _grid(points: Array) -> Array:
    """About _CELLS points of a grid over the box around points."""
    low, high = points.min(axis=0), points.max(axis=0)
    size = np.maximum(high - low, 1e-3)
    step = float((size.prod() / _CELLS) ** (1 / 3))
    axes = [np.linspace(a, b, max(3, round((b - a) / step))) for a, b in zip(low, high, strict=True)]
    found: Array = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return found


def _extremes(triangles: Array) -> Array:
    """The corners that lie furthest out in many directions."""
    directions = np.random.default_rng(1).normal(size=(100, 3))
    corners = triangles.reshape(-1, 3)
    furthest: Array = corners[np.unique(np.argmax(corners @ directions.T, axis=0))]
    return furthest


def boundary(balls: Array, count: int) -> tuple[Array, Array, Array]:
    """Points (n, 3) on the boundary of a union of balls, `count` on each ball; the area that each stands for, and its normal."""
    z = 1 - (2 * np.arange(count) + 1) / count
    angle = np.pi * (3 - np.sqrt(5)) * np.arange(count)
    flat = np.sqrt(1 - z * z)
    around = np.column_stack((flat * np.cos(angle), flat * np.sin(angle), z))
    points = (balls[:, None, :3] + balls[:, None, 3:] * around).reshape(-1, 3)
    outer = (cdist(points, balls[:, :3]) - balls[:, 3]).min(axis=1) > -1e-9
    return points[outer], np.repeat(balls[:, 3] ** 2, count)[outer], np.tile(around, (len(balls), 1))[outer]


def _rounded(balls: Array) -> Array:
    return np.column_stack((np.round(balls[:, :3], 4), balls[:, 3]))


def _written(balls: Array) -> Array:
    return np.column_stack((balls[:, :3], np.ceil(balls[:, 3] * 1e4 - 1e-6) / 1e4 + 0.0))
