"""RRT-Connect: the first free path from a start to a goal."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.robot_model import RobotModel
from zarm_geometry.working_memory import working_memory
from zarm_geometry.world import World
from zarm_planner.deadline import Deadline
from zarm_planner.kernels.rrt_connect import connect
from zarm_planner.kernels.trees import make_trees
from zarm_trajectory.arrays import Array

ENDLESS = 2**62
"""More samples than any search reaches."""


def search(
    model: RobotModel, world: World, start: Array, goals: Array, *, seed: int, deadline: Deadline, most: int = ENDLESS
) -> Array | None:
    """A free path (n, dof) from `start` (dof,) to one of `goals` (m, dof); None after `most` samples or at `deadline`.

    Start and goals are free and within the limits, the nearest goal first; straight lines are tried in that order. The
    same seed gives the same path. Consecutive rows are joined by straight edges that are free to
    `kernels.collision.RESOLUTION`.
    """
    goals = goals.reshape(-1, model.dof)
    found, _ = connect(
        model.arrays,
        world.arrays,
        working_memory(model.arrays),
        make_trees(model.dof),
        sampling_range(model, np.vstack((start, goals))),
        model.weight,
        np.array(start, np.float32, order="C"),
        np.array(goals, np.float32, order="C"),
        np.array([seed], np.uint64),
        most,
        deadline.at,
    )
    if len(found) == 0:
        return None
    path = found.astype(np.float64)
    # The kernels compute in float32: restore the caller's exact ends, and let no rounding exceed a limit.
    path = np.clip(path, model.lower, model.upper)
    path[0] = start
    path[-1] = goals[np.argmin(np.abs(goals - found[-1]).max(axis=1))]
    return path


def sampling_range(model: RobotModel, ends: Array) -> NDArray[np.float32]:
    """The sampling range (2, dof), lower and upper, of a search between `ends` (n, dof).

    A joint with a range of more than one turn need not be sampled over all of it: within half a turn of the start and
    the goals every posture occurs.
    """
    half_turn = np.where(model.revolute, np.pi, np.inf)
    lower = np.maximum(model.lower, ends.min(axis=0) - half_turn)
    upper = np.minimum(model.upper, ends.max(axis=0) + half_turn)
    return np.array((lower, upper), np.float32)
