"""Whether configurations and straight edges between them are free, with the robot as spheres."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from zarm_geometry.kernels.edge import path_free
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.working_memory import working_memory
from zarm_geometry.world import World


def is_free(model: RobotModel, world: World, path: ArrayLike) -> bool:
    """Whether a configuration (dof,) or every edge of a path (n, dof) is free of the world and of self-collision.

    In spheres, with the world's margin around them, and to `kernels.collision.RESOLUTION`.
    """
    rows = np.array(path, np.float32, order="C").reshape(-1, model.dof)
    return path_free(model.arrays, world.arrays, working_memory(model.arrays), rows)
