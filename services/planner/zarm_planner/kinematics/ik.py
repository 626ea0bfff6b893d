"""Inverse kinematics: joint solutions for a pose of the tip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from zarm_geometry.robot_model import RobotModel
from zarm_geometry.working_memory import working_memory
from zarm_geometry.world import World
from zarm_planner.deadline import Deadline
from zarm_planner.kernels.inverse import TURN, Chain, solve
from zarm_trajectory.arrays import Array

COLLIDING = 64
"""Colliding solutions after which the search for a free one gives up."""


@dataclass(frozen=True)
class IkResult:
    """Solutions of one pose.

    `solutions` (n, dof) are within the limits, free, and nearest first; `colliding` (m, dof) reach the pose but
    collide, nearest first. `distance` (m) and `angle` (rad) are the errors of the best attempt.
    """

    solutions: Array
    colliding: Array
    distance: float
    angle: float


def solve_ik(
    model: RobotModel,
    pose: Array,
    near: Array,
    *,
    world: World | None,
    max_solutions: int,
    seed: int,
    deadline: Deadline,
) -> IkResult:
    """Solve for a pose (4, 4) of the tip in the base frame, to 1e-6 m and 1e-6 rad, starting at `near` (dof,).

    Solutions differ by more than 0.1 rad in some joint; a joint with a range of several turns gives one for each turn,
    a continuous joint only the one nearest to `near`.
    With a `world`, solutions collide in spheres neither with it nor with the robot itself. With `max_solutions` 1, the
    first one found is returned: the one that `near` leads to, unless that collides.
    """
    free = np.empty((max_solutions, model.dof))
    colliding = np.empty((COLLIDING, model.dof))
    lower, upper = model.range_about(near)
    found = solve(
        chain_of(model)._replace(lower=lower, upper=upper),
        model.arrays,
        (world or NOTHING).arrays,
        working_memory(model.arrays),
        world is not None,
        np.array(pose, np.float64, order="C"),
        np.array(near, np.float64, order="C"),
        free,
        colliding,
        np.array([seed], np.uint64),
        deadline.at,
    )
    return IkResult(
        with_turns(model, free[: found.free], near, max_solutions),
        nearest_first(colliding[: found.colliding], near),
        found.distance,
        found.angle,
    )


NOTHING = World((), 0.0)
"""A world without obstacles."""


def chain_of(model: RobotModel) -> Chain:
    """The kinematics of a robot with one tip in the kernels' form."""
    return Chain(model.tree.table, model.origin, model.offset[-1], model.lower, model.upper)


def with_turns(model: RobotModel, solutions: Array, near: Array, most: int) -> Array:
    """The `most` nearest among solutions and all that differ from them by full turns; each input is its own nearest
    turn.
    """
    rows = nearest_first(solutions, near)
    if most == 1:
        return rows
    for k in np.flatnonzero(model.revolute & (model.upper - model.lower >= TURN) & ~model.continuous):
        # A row that is not among the nearest after turning one joint will not be after turning another one away too.
        turns = np.arange(-((model.upper[k] - model.lower[k]) // TURN), (model.upper[k] - model.lower[k]) // TURN + 1)
        turned = np.repeat(rows, len(turns), axis=0)
        turned[:, k] += np.tile(turns * TURN, len(rows))
        within = (turned[:, k] >= model.lower[k]) & (turned[:, k] <= model.upper[k])
        rows = nearest_first(turned[within], near)[:most]
    return rows


def nearest_first(rows: Array, near: Array) -> Array:
    """Configurations (n, dof) by their distance from `near` (dof,)."""
    return rows if len(rows) < 2 else rows[((rows - near) ** 2).sum(axis=1).argsort(kind="stable")]
