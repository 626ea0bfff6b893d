"""Shortcuts: makes a path shorter, and chooses the quickest of several."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.robot_model import RobotModel
from zarm_geometry.working_memory import working_memory
from zarm_geometry.world import World
from zarm_planner.deadline import Deadline
from zarm_planner.kernels import leg
from zarm_planner.kernels import shortcut as kernel
from zarm_planner.kernels.trees import make_trees
from zarm_planner.search.rrt_connect import sampling_range
from zarm_trajectory.arrays import Array


def shortcut(model: RobotModel, world: World, path: Array, *, seed: int, deadline: Deadline) -> Array:
    """A free path (m, dof) between the ends of the free `path` (n, dof) that is no longer, without repeated rows.

    If both ends are the same configuration, the path can be one row. The same seed gives the same path. `deadline` only
    makes it end sooner, with the best path so far.
    """
    buffer = np.empty((len(path) + kernel.MOST_SHORTCUTS, model.dof), np.float32)
    buffer[: len(path)] = path
    rows = kernel.shortcut(
        model.arrays,
        world.arrays,
        working_memory(model.arrays),
        buffer,
        len(path),
        np.array([seed], np.uint64),
        deadline.at,
    )
    return _without_repeats(model, buffer[:rows], path[0], path[-1])


class Quickest(NamedTuple):
    """A path (n, dof), if there is one, and the seconds that its search and shortcuts took."""

    path: Array | None
    search: float
    shortcut: float


def quickest_of(
    model: RobotModel,
    world: World,
    start: Array,
    goal: Array,
    fastest: Array,
    within: float,
    *,
    seeds: Sequence[int],
    deadline: Deadline,
    most: int,
) -> Quickest:
    """The quickest of the paths, with shortcuts, that `seeds` give from `start` (dof,) to `goal` (dof,).

    A path is timed by moving along each edge with one joint at its maximum speed `fastest` (dof,). There is none if
    `deadline` passed, or searches reached `most` samples, before one was found that takes less than `within` s.
    """
    spent = np.zeros(2)
    rows = leg.quickest_of(
        model.arrays,
        world.arrays,
        working_memory(model.arrays),
        make_trees(model.dof),
        sampling_range(model, np.stack((start, goal))),
        model.weight,
        np.array((start, goal), np.float32),
        fastest.astype(np.float32),
        within,
        np.array(seeds, np.uint64),
        most,
        deadline.at,
        spent,
    )
    path = _without_repeats(model, rows, start, goal) if len(rows) else None
    return Quickest(path, float(spent[0]), float(spent[1]))


def _without_repeats(model: RobotModel, rows: NDArray[np.float32], start: Array, end: Array) -> Array:
    return kernel.without_repeats(rows, start, end, model.lower, model.upper)
