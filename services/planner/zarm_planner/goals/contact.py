"""Ways out of configurations with little or no clearance."""

from __future__ import annotations

import numpy as np

from zarm_geometry.exact import RESOLUTION, ExactScene
from zarm_geometry.kernels.motion import NO_MOVERS, motion
from zarm_geometry.kernels.nearby import GRADIENT
from zarm_geometry.working_memory import working_memory
from zarm_planner.context import PlanningContext
from zarm_planner.kernels import contact
from zarm_planner.kinematics.ik import chain_of
from zarm_trajectory.arrays import Array

_ENOUGH_CLEARANCE = 0.005
"""Clearance (m) that is enough for a goal."""
_ROWS = 150
"""Most steps of a walk; out of a slot of 1 mm and 20 cm depth it takes about 60."""
_MOST_NEAR = 64
"""Most distances considered at once."""


def clear_pose(context: PlanningContext, pose: Array, q: Array) -> tuple[Array, float]:
    """Joints (dof,) near `q` that also reach the tip `pose` (4, 4), with as much clearance as possible, up to _ROOM; and
    that clearance (m).

    Only a redundant arm has such alternatives.
    """
    model, found = context.model, np.array(q)
    clearance = contact.clear_pose(
        chain_of(model), _surroundings(context.exact), pose, _ENOUGH_CLEARANCE, found, context.deadline.at
    )
    return found, clearance


def way_out(context: PlanningContext, q: Array, direction: Array) -> Array | None:
    """A path (n, dof) from `q` (dof,), free in exact geometry, to where the robot is free in spheres.

    It goes in a `direction` (dof,) of unit length, and slides along obstacles. None if that leads nowhere.
    """
    model, way = context.model, np.empty((_ROWS, context.model.dof))
    way[0] = q
    count = contact.retreat(
        model.arrays,
        context.world.arrays,
        working_memory(model.arrays),
        chain_of(model),
        _surroundings(context.exact),
        direction,
        way,
        context.deadline.at,
    )
    return _straightened(context, way[:count]) if count else None


def edge_is_free(context: PlanningContext, a: Array, b: Array) -> bool:
    """Whether the straight edge between two configurations (dof,) is free in exact geometry."""
    return context.exact.is_free(points(context.exact, a, b), context.deadline.check)


def points(scene: ExactScene, a: Array, b: Array) -> Array:
    """Configurations (n, dof) along a straight edge, at most RESOLUTION apart."""
    return np.linspace(a, b, int(np.abs(b - a) @ scene.reach / RESOLUTION) + 2)


def _straightened(context: PlanningContext, way: Array) -> Array | None:
    """The path with as few corners as bisection finds; None if it is not free."""
    if edge_is_free(context, way[0], way[-1]):
        return way[[0, -1]]
    if len(way) == 2:
        return None
    middle = len(way) // 2
    first, second = _straightened(context, way[: middle + 1]), _straightened(context, way[middle:])
    return None if first is None or second is None else np.vstack((first[:-1], second))


def _surroundings(scene: ExactScene) -> contact.Surroundings:
    dof = scene.model.dof
    body, world, standing = scene.solids
    return contact.Surroundings(
        body,
        world,
        standing,
        world.checked,
        NO_MOVERS,
        motion(body, np.array((0.0, 1.0)), np.zeros((2, dof)), np.zeros(dof)),
        np.empty((_MOST_NEAR, GRADIENT + dof)),
    )
