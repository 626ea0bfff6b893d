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


def shorten(model: RobotModel, world: World, path: Array, *, seed: int, stop: Stop) -> Array:
    """A free path (m, dof) between the ends of the free `path` (n, dof) that is no longer, without repeated rows.

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
    shorter = np.clip(room[:rows].astype(np.float64), model.lower, model.upper)
    shorter[0], shorter[-1] = path[0], path[-1]
    moves = np.any(np.diff(shorter, axis=0) != 0.0, axis=1)
    return shorter[np.concatenate(([True], moves))]
