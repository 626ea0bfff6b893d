"""The sphere cover of a robot: spheres that contain the exact geometry of its links, for the search.

The cost is the space that the balls occupy outside a link, compared to the link's size, and more the farther it is. The
more joints carry a link, the more it counts: a gripper reaches into narrow places. Each link begins as one ball.
The ball whose split frees the most space is split repeatedly, until the whole robot has its budget of balls; and balls
are moved and shrunk to what they alone contain. So few balls are spent where more would change little, such as along a
tube or into the edges of its ends. Containment is then proven, not sampled: `kernels.balls` grows the balls until
nothing is outside.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist
from scipy.stats import qmc

from zarm_geometry.packed_shapes import distances
from zarm_robot_import.kernels.balls import around_shapes
from zarm_robot_import.kernels.middles import middles
from zarm_robot_import.primitives import below, triangles_of
from zarm_robot_import.triangles import areas, points_on
from zarm_trajectory.arrays import Array

BUDGET = 80
"""Balls in the cover of the whole robot."""
BASE_WEIGHT = 0.25
"""Weight of the space around what stands on the base: the scene is checked only against the moving links."""
OUTWARD = 1.2
"""Factor by which each joint increases the weight of the space around what it carries."""
_POINTS, _INNER = 3000, 700
"""Points on the boundary of a link and inside it to which its balls are fitted, ..."""
_MORE_POINTS, _MORE_INNER = 20_000, 6000
"""... and those checked at the end: uncovered ones are added to the others."""
_SURFACE = 500
"""Points on a ball at which its protrusion is measured."""
_OUTSIDE = 3000
"""Points in the space around a link."""
_FAR = 0.02
"""Space at a distance d (m) has the weight 1 + (d / _FAR)^2."""
_CUTS = (0.3, 0.5, 0.7)
"""Cuts along the main axes of a ball's part of the link, as shares of the length."""
_STEPS = (0.016, 0.008, 0.004, 0.002)
"""Step sizes (m) for moving balls; `_LAST_STEPS` are those at the end."""
_LAST_STEPS = (0.008, 0.004, 0.002, 0.001)
_ROUNDS = 4
_AROUND = np.array([(x, y, z) for x in (0, 1, -1) for y in (0, 1, -1) for z in (0, 1, -1)], float)
_SMALLEST = 0.002
"""Least radius (m) of a ball; one of 0.1 mm has no drawable surface."""
_FINEST = 5e-4
"""Finest subdivision (m) of the proof."""


def fit_covers(rows: Mapping[str, Array], carried: Mapping[str, int], budget: int = BUDGET) -> dict[str, Array]:
    """Balls (n, 4) of each link, in the descriptor's form, that contain its exact geometry (m, 17).

    They are at most `budget` in all, but at least one each. `carried` says how many joints carry each link.
    """
    links = {
        link: _Link.of(table, OUTWARD ** carried[link] if carried[link] else BASE_WEIGHT)
        for link, table in rows.items()
    }
    covers = {link: _around(each.points)[None] for link, each in links.items()}
    for _ in range(_ROUNDS):
        covers = _split(links, covers, max(budget, len(rows)))
        covers = {link: _improved(links[link], balls) for link, balls in covers.items()}
    return {
        link: _written(around_shapes(_rounded(_completed(links[link], balls)), rows[link], _FINEST))
        for link, balls in covers.items()
    }


def ball_rows(balls: Array) -> Array:
    """Balls (n, 4) as rows (n, 17) of `zarm_geometry.packed_shapes`."""
    rows = np.zeros((len(balls), 17))
    rows[:, [0, 5, 10]] = 1.0
    rows[:, [3, 7, 11]] = -balls[:, :3]
    rows[:, 16] = balls[:, 3]
    return rows


def depths(points: Array, rows: Array) -> Array:
    """Lower bounds (n,) on the depth of points below the surface of the union of shapes (m, 17); not above 0 outside."""
    found: Array = -distances(points, rows).min(axis=1)
    return found


def outer_points(rows: Array, count: int) -> Array:
    """About `count` points (n, 3) on the boundary of the union of shapes (m, 17)."""
    surfaces = [triangles_of(row) for row in rows]
    sizes = np.array([areas(surface).sum() for surface in surfaces])
    counts = np.maximum(np.round(count * sizes / sizes.sum()).astype(int), 40)
    found = []
    for i, (surface, number) in enumerate(zip(surfaces, counts.tolist(), strict=True)):
        corners = np.unique(surface.reshape(-1, 3), axis=0)
        points = np.concatenate([points_on(surface, number)[0], corners])
        found.append(points[~below(points, np.delete(rows, i, axis=0))])
    return np.concatenate(found)


def protrusion(ball: Array, rows: Array) -> float:
    """How far (m) a ball (4,) protrudes from the union of the shapes (m, 17), measured at points on its surface."""
    return -float(depths(outer_points(ball_rows(ball[None]), _SURFACE), rows).min())


@dataclass
class _Link:
    """Points (n, 3) of a link that its balls must contain, and the space around it: points `out` (k, 3) with weights
    `cost` (k,).

    `rows` (m, 17) are its exact geometry.
    """

    rows: Array
    points: Array
    out: Array
    cost: Array

    @classmethod
    def of(cls, rows: Array, weight: float) -> Self:
        points = _points_of(rows, _POINTS, _INNER)
        low, high = points.min(axis=0), points.max(axis=0)
        weight /= float(np.square(high - low).sum())
        beside = 0.02 + 0.25 * float((high - low).max())
        low, high = low - beside, high + beside
        space = qmc.scale(qmc.Halton(3, scramble=False).random(_OUTSIDE), low, high)
        away = distances(space, rows).min(axis=1)
        cost = weight * float((high - low).prod()) / _OUTSIDE * (1 + (away / _FAR) ** 2)
        return cls(rows, points, space[away > 0.0], cost[away > 0.0])

    def taken(self, balls: Array) -> float:
        """The cost of the space that balls (n, 4) occupy."""
        return float(self.cost[_within(self.out, balls).any(axis=1)].sum())


def _points_of(rows: Array, outer: int, inner: int) -> Array:
    """Points (n, 3) throughout shapes (m, 17)."""
    grid = np.concatenate([_grid(row, inner // len(rows)) for row in rows])
    return np.concatenate([outer_points(rows, outer), grid[below(grid, rows)]])


def _grid(row: Array, count: int) -> Array:
    """About `count` points (n, 3) of a grid over the box around a shape (17,), along its axes; thin shapes get some
    too.
    """
    half = row[12:15] + row[16] + (row[15], row[15], 0.0)
    frame = row[:12].reshape(3, 4)
    size = np.maximum(2 * half, 1e-3)
    step = float((size.prod() / max(count, 1)) ** (1 / 3))
    axes = [np.linspace(-a, a, max(3, round(2 * a / step))) for a in half]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    found: Array = (grid - frame[:, 3]) @ frame[:, :3]
    return found


def _within(points: Array, balls: Array) -> NDArray[np.bool_]:
    """Which points (n, 3) are in which of the balls (m, 4): (n, m)."""
    found: NDArray[np.bool_] = cdist(points, balls[:, :3]) <= balls[:, 3] + 1e-9
    return found


def _around(points: Array) -> Array:
    """A small ball (4,) that contains points (n, 3)."""
    middle = middles(points[None])[0]
    return np.append(middle, max(float(np.linalg.norm(points - middle, axis=1).max()), _SMALLEST))


def _nearest(points: Array, balls: Array) -> NDArray[np.intp]:
    """For points (n, 3) the ball (n,) that is closest to containing each, or contains it the deepest."""
    found: NDArray[np.intp] = np.argmin(cdist(points, balls[:, :3]) - balls[:, 3], axis=1)
    return found


def _split(links: Mapping[str, _Link], covers: Mapping[str, Array], count: int) -> dict[str, Array]:
    """The balls, with those split whose split frees the most space, until there are `count` in all."""
    covers = dict(covers)
    halves = {link: [_halves(links[link], balls, i) for i in range(len(balls))] for link, balls in covers.items()}
    while sum(map(len, covers.values())) < count:
        options = ((half[0], link, i) for link, each in halves.items() for i, half in enumerate(each))
        freed, link, index = max(options)
        if freed <= 0.0:
            break
        covers[link] = np.concatenate([np.delete(covers[link], index, axis=0), halves[link].pop(index)[1]])
        last = len(covers[link]) - 1
        halves[link] += [_halves(links[link], covers[link], i) for i in (last - 1, last)]
    return covers


def _halves(link: _Link, balls: Array, index: int) -> tuple[float, Array]:
    """Two balls (2, 4) instead of one, and how much less space they occupy."""
    points = link.points[_nearest(link.points, balls) == index]
    free = ~_within(link.out, np.delete(balls, index, axis=0)).any(axis=1)
    out, cost = link.out[free], link.cost[free]
    before = cost[_within(out, balls[index : index + 1])[:, 0]].sum()
    best = (0.0, balls[[index, index]])
    if len(points) < 2:
        return best
    for axis in np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]:
        along = points @ axis
        for share in _CUTS:
            below = along < along.min() + share * np.ptp(along)
            if not below.any() or below.all():
                continue
            two = np.array([_around(points[below]), _around(points[~below])])
            freed = float(before - cost[_within(out, two).any(axis=1)].sum())
            if freed > best[0]:
                best = (freed, two)
    return best


def _improved(link: _Link, balls: Array) -> Array:
    """The best of several rounds in which balls are moved, and points go to the ball that contains them the deepest, as
    in k-means.
    """
    best, least = balls, np.inf
    for _ in range(2):
        moved = _moved(link, balls, _STEPS)
        if (taken := link.taken(moved)) < least:
            best, least = moved, taken
        owner = _nearest(link.points, best)
        balls = np.array([_around(link.points[owner == i]) for i in np.unique(owner)])
    return best


def _moved(link: _Link, balls: Array, steps: Collection[float]) -> Array:
    """Balls, each in turn moved and shrunk to where containing what it alone contains costs the least.

    What is contained stays contained; a ball that contains nothing alone is dropped.
    """
    for step in steps:
        balls = balls.copy()
        inside, outside = _within(link.points, balls), _within(link.out, balls)
        times, taken = inside.sum(axis=1), outside.sum(axis=1)
        kept = np.ones(len(balls), bool)
        for i in np.argsort(-balls[:, 3]):
            alone = link.points[inside[:, i] & (times == 1)]
            times -= inside[:, i]
            taken -= outside[:, i]
            if not len(alone):
                kept[i] = False
                continue
            centers = np.concatenate([balls[i, :3] + step * _AROUND, [_around(alone)[:3]]])
            radii = np.maximum(cdist(centers, alone).max(axis=1), _SMALLEST)
            out, cost = link.out[taken == 0], link.cost[taken == 0]
            best = int(np.argmin((cdist(centers, out) <= radii[:, None]) @ cost + 1e-12 * radii))
            balls[i] = (*centers[best], radii[best])
            inside[:, i] = _within(link.points, balls[i : i + 1])[:, 0]
            outside[:, i] = _within(link.out, balls[i : i + 1])[:, 0]
            times += inside[:, i]
            taken += outside[:, i]
        balls = balls[kept]
    return balls


def _completed(link: _Link, balls: Array) -> Array:
    """The balls refitted to many more points, so that the exact check has to enlarge them little."""
    more = _points_of(link.rows, _MORE_POINTS, _MORE_INNER)
    for steps in (_LAST_STEPS, _LAST_STEPS, _LAST_STEPS, ()):
        owner = _nearest(more, balls)
        lack = np.linalg.norm(more - balls[owner, :3], axis=1) - balls[owner, 3]
        missed = lack > 0.0
        link.points = np.concatenate([link.points, more[missed]])
        balls = balls.copy()
        np.maximum.at(balls[:, 3], owner[missed], balls[owner[missed], 3] + lack[missed] + 1e-9)
        balls = _moved(link, balls, steps)
    return balls


def _rounded(balls: Array) -> Array:
    return np.column_stack((np.round(balls[:, :3], 4), balls[:, 3]))


def _written(balls: Array) -> Array:
    return np.column_stack((balls[:, :3], np.ceil(balls[:, 3] * 1e4 - 1e-6) / 1e4 + 0.0))
