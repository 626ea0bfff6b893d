"""Motions that keep what is held of the tip's pose: search, shorten and time, without leaving the manifold."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.collision import is_free
from zarm_geometry.kernels.arrays import memory
from zarm_geometry.world import World
from zarm_planner.held import Held
from zarm_planner.kernels.constrained import ROWS, connect_held, shortcut_held
from zarm_planner.kernels.manifold import Hold
from zarm_planner.kernels.trees import make_trees
from zarm_planner.motion import Limits, Motion
from zarm_planner.search import ENDLESS, sampling_range
from zarm_planner.stop import Stop
from zarm_planner.timing import through, time_curve

Array = NDArray[np.float64]

_SPACING = 0.1
"""Rad: between the points through which the curve goes at first."""
_ROUNDS = 5
"""How often the curve may be brought closer to the path, each time with points half as far apart."""
_ON_MANIFOLD = 2
"""In so many rounds the points are brought onto the manifold; after that they stay on the steps of the path."""
_LOOKS = 4
"""Moments looked at per interval between two points of the curve."""
_INSIDE = 0.01
"""Rad or m: a path keeps so far away from the ends of the joints' ranges, for the curve through it swings out where a joint
comes to rest at one."""
_RANGE = 8e-5
"""Rad or m by which a curve may be outside the joints' ranges; a little less than `verify` allows."""
_ROOM = 0.9
"""The part of the tolerances that the curve may use there."""


def search_held(
    world: World, held: Held, start: Array, goals: Array, *, seed: int, stop: Stop, most: int = ENDLESS
) -> Array | None:
    """A free path (n, dof) from `start` (dof,) to one of `goals` (m, dof); None when `most` samples or `stop` came first.

    Straight edges between its rows are free to `kernels.collision.RESOLUTION`, and keep what is held.
    """
    model = held.model
    goals = goals.reshape(-1, model.dof)
    begin = _on_manifold(world, held, start)
    ends = [(goal, end) for goal in goals if (end := _on_manifold(world, held, goal)) is not None]
    if begin is None or not ends:
        return None
    found = connect_held(
        model.arrays,
        world.arrays,
        memory(model.arrays),
        make_trees(model.dof),
        _inside(held, np.vstack((start, goals))),
        sampling_range(model, np.vstack((start, goals))),
        model.weight,
        begin.astype(np.float32),
        np.array([end for _, end in ends], np.float32),
        np.array([seed], np.uint64),
        most,
        stop.deadline,
    )
    if len(found) == 0:
        return None
    reached = int(np.argmin([np.abs(end - found[-1]).max() for _, end in ends]))
    return np.vstack((start, np.clip(found, model.lower, model.upper), ends[reached][0]))


def shorten_held(world: World, held: Held, path: Array, *, seed: int, stop: Stop) -> Array:
    """A path (m, dof) between the ends of `path` (n, dof), as free and as true to what is held, that is no longer.

    `stop` only makes it end sooner.
    """
    model = held.model
    room = np.empty((ROWS, model.dof), np.float32)
    inner = path[1:-1]
    if len(inner) > ROWS:
        return path
    room[: len(inner)] = inner
    count = shortcut_held(
        model.arrays,
        world.arrays,
        memory(model.arrays),
        _inside(held, path),
        room,
        len(inner),
        np.array([seed], np.uint64),
        stop.deadline,
    )
    return np.vstack((path[0], np.clip(room[:count], model.lower, model.upper), path[-1]))


def time_held(
    held: Held,
    path: Array,
    limits: Limits,
    dt: float,
    *,
    free: Callable[[Array], bool],
    stop: Stop,
    vias: Sequence[int] = (),
) -> Motion | None:
    """The fast motion along a smooth curve through points of `path` (n, dof), sampled every `dt` s or a little less.

    Its rows `vias` are among them, so that the motion passes these exactly. Where configurations (n, dof) along the curve are
    not `free`, or lose what is held, the points are put closer together. None
    where that does not help, or `stop` came first.

    Raises InvalidRequest where the limits make the motion longer than `motion.MAX_SAMPLES`.
    """
    length = np.insert(np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1)), 0, 0.0)
    if length[-1] < 1e-6:
        return Motion.standing(path[0], dt)
    allowed = max(_ROOM, float(held.use(path[[0, -1]]).max()))
    for halved in range(_ROUNDS):
        if stop.passed:
            return None
        at, fixed = _along(length[[0, *vias, len(path) - 1]], _SPACING / 2**halved)
        points = np.stack([np.interp(at, length, joint) for joint in path.T], axis=1)
        # Between the ends of a step the manifold may touch what the step, known to be free, does not: in the end the curve
        # keeps to the steps themselves.
        if halved < _ON_MANIFOLD and (near := held.projected(points[~fixed])) is not None:
            points[~fixed] = near
        curve = through(points)
        looks = np.linspace(0.0, curve.duration, _LOOKS * len(points))
        rows, _, _ = curve.at(looks)
        if (
            np.all(np.maximum(held.model.lower - rows, rows - held.model.upper) <= _RANGE)
            and held.use(rows).max() <= allowed
            and free(rows)
        ):
            return time_curve(curve, limits, dt)
    return None


def _along(knots: Array, spacing: float) -> tuple[Array, NDArray[np.bool_]]:
    """Lengths (n,) along a path, `spacing` apart at most and at least three to a stretch between `knots` (k,), which are among
    them; and which these are (n,).
    """
    at, fixed = [knots[:1]], [np.ones(1, np.bool_)]
    for a, b in itertools.pairwise(knots):
        count = max(3, math.ceil((b - a) / spacing)) if b > a else 0
        at.append(np.linspace(a, b, count + 1)[1:])
        fixed.append(np.arange(count) == count - 1)
    return np.concatenate(at), np.concatenate(fixed)


def _inside(held: Held, rows: Array) -> Hold:
    """What is held, with joints' ranges narrower by _INSIDE, as far as they still hold `rows` (n, dof)."""
    chain = held.hold.chain
    lower = np.maximum(chain.lower, np.minimum(chain.lower + _INSIDE, rows.min(axis=0)))
    upper = np.minimum(chain.upper, np.maximum(chain.upper - _INSIDE, rows.max(axis=0)))
    return held.hold._replace(chain=chain._replace(lower=lower, upper=upper))


def _on_manifold(world: World, held: Held, q: Array) -> Array | None:
    """The configuration nearest to `q` (dof,) that keeps what is held; None where `q` cannot get there freely."""
    rows = held.projected(q)
    if rows is None or not np.any(rows[0] != q):
        return None if rows is None else q
    way = np.linspace(q, rows[0], 5)
    return rows[0] if held.use(way).max() <= 1.0 and is_free(held.model, world, way[[0, -1]]) else None
