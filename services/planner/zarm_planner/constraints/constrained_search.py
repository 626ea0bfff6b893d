"""Search and shortcuts that keep a path constraint, without leaving its manifold."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.collision import is_free
from zarm_geometry.working_memory import working_memory
from zarm_geometry.world import World
from zarm_planner.constraints.path_constraint import ConstraintManifold
from zarm_planner.deadline import Deadline
from zarm_planner.kernels import constrained as kernel
from zarm_planner.kernels.manifold import ConstraintArrays
from zarm_planner.kernels.trees import make_trees
from zarm_planner.search.rrt_connect import ENDLESS, sampling_range
from zarm_trajectory.arrays import Array

_INSIDE = 0.01
"""Rad or m: a path keeps this far from the joint limits, because the curve through it overshoots where a joint comes to
rest.
"""


def search_constrained(
    world: World,
    constraint: ConstraintManifold,
    start: Array,
    goals: Array,
    *,
    seed: int,
    deadline: Deadline,
    most: int = ENDLESS,
) -> Array | None:
    """A free path (n, dof) from `start` (dof,) to one of `goals` (m, dof); None after `most` samples or at `deadline`.

    Straight edges between its rows are free to `kernels.collision.RESOLUTION`, and keep the constraint.
    """
    model = constraint.model
    goals = goals.reshape(-1, model.dof)
    begin = _on_manifold(world, constraint, start)
    ends = [(goal, end) for goal in goals if (end := _on_manifold(world, constraint, goal)) is not None]
    if begin is None or not ends:
        return None
    found = kernel.connect_constrained(
        model.arrays,
        world.arrays,
        working_memory(model.arrays),
        make_trees(model.dof),
        _inside(constraint, np.vstack((start, goals))),
        sampling_range(model, np.vstack((start, goals))),
        model.weight,
        begin.astype(np.float32),
        np.array([end for _, end in ends], np.float32),
        np.array([seed], np.uint64),
        most,
        deadline.at,
    )
    if len(found) == 0:
        return None
    reached = int(np.argmin([np.abs(end - found[-1]).max() for _, end in ends]))
    return np.vstack((start, np.clip(found, model.lower, model.upper), ends[reached][0]))


def shortcut_constrained(
    world: World, constraint: ConstraintManifold, path: Array, *, seed: int, deadline: Deadline
) -> Array:
    """A path (m, dof) between the ends of `path` (n, dof) that is no longer, and as free and within the constraint.

    `deadline` only makes it end sooner.
    """
    model = constraint.model
    buffer = np.empty((kernel.ROWS, model.dof), np.float32)
    inner = path[1:-1]
    if len(inner) > kernel.ROWS:
        return path
    buffer[: len(inner)] = inner
    count = kernel.shortcut_constrained(
        model.arrays,
        world.arrays,
        working_memory(model.arrays),
        _inside(constraint, path),
        buffer,
        len(inner),
        np.array([seed], np.uint64),
        deadline.at,
    )
    return np.vstack((path[0], np.clip(buffer[:count], model.lower, model.upper), path[-1]))


def led_to(constraint: ConstraintManifold, start: Array, goals: Array) -> NDArray[np.bool_]:
    """To which of `goals` (m, dof) a straight way along the manifold leads from `start` (dof,), free or not. The others may be in
    a part of it that cannot be reached at all.
    """
    found = np.zeros(len(goals), np.bool_)
    kernel.straight_ways(constraint.arrays, start.astype(np.float32), goals.astype(np.float32), found)
    return found


def _inside(constraint: ConstraintManifold, rows: Array) -> ConstraintArrays:
    """The constraint with joint ranges narrowed by _INSIDE, but still containing `rows` (n, dof)."""
    chain = constraint.arrays.chain
    lower = np.maximum(chain.lower, np.minimum(chain.lower + _INSIDE, rows.min(axis=0)))
    upper = np.minimum(chain.upper, np.maximum(chain.upper - _INSIDE, rows.max(axis=0)))
    return constraint.arrays._replace(chain=chain._replace(lower=lower, upper=upper))


def _on_manifold(world: World, constraint: ConstraintManifold, q: Array) -> Array | None:
    """The configuration nearest to `q` (dof,) that keeps the constraint; None if the way there from `q` is not free."""
    rows = constraint.projected(q)
    if rows is None or not np.any(rows[0] != q):
        return None if rows is None else q
    way = np.linspace(q, rows[0], 5)
    return rows[0] if constraint.use(way).max() <= 1.0 and is_free(constraint.model, world, way[[0, -1]]) else None
