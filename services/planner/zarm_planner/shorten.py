"""A shorter path along a given one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from zarm_planner.kernels.arrays import memory
from zarm_planner.kernels.shortcut import MOST, shortcut
from zarm_planner.robot_model import RobotModel
from zarm_planner.stop import Stop
from zarm_planner.world import World

Array = NDArray[np.float64]

_SAME = 1e-6
"""Rows nearer to each other (rad) differ by the rounding of float32."""


def shorten(model: RobotModel, world: World, path: Array, *, seed: int, stop: Stop) -> Array:
    """A free path (m, dof) between the ends of the free `path` (n, dof) that is no longer, without repeated rows.

    Where both ends are one configuration the path can be one row.
    The same seed gives the same path. `stop` only makes it end sooner: the path so far is a good one.
    """
    room = np.empty((len(path) + MOST, model.dof), np.float32)
    room[: len(path)] = path
    rows = shortcut(
        model.arrays,
        world.arrays,
        memory(model.arrays),
        room,
        len(path),
        np.array([seed], np.uint64),
        stop.deadline,
    )
    shorter = [path[0]]
    for row in np.clip(room[1 : rows - 1].astype(np.float64), model.lower, model.upper):
        if min(np.abs(row - shorter[-1]).max(), np.abs(row - path[-1]).max()) > _SAME:
            shorter.append(row)
    if np.any(path[-1] != shorter[-1]):
        shorter.append(path[-1])
    return np.array(shorter)
