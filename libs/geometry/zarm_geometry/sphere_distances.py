"""The distance of each of the robot's collision spheres to the scene."""

from __future__ import annotations

import numpy as np

from zarm_geometry.exact import MAX_CLEARANCE
from zarm_geometry.packed_shapes import distances
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_trajectory.arrays import Array

_BLOCK = 4096
"""Shapes of the scene processed together, to limit memory."""


def sphere_distances(model: RobotModel, world: World, q: Array) -> Array:
    """Distances (n,) in m of the descriptor's spheres to the nearest object at `q` (dof,), in the descriptor's order.

    Negative values are the depth of the sphere in one of the convex shapes of the objects; at most MAX_CLEARANCE. All
    spheres are included, also those of links that are ignored or fixed to the base.
    """
    spheres = model.robot.descriptor.spheres
    poses = dict(zip(model.links, model.link_transforms(q), strict=True))
    centers = np.array([poses[link][:3] @ [*ball.center, 1.0] for link, balls in spheres.items() for ball in balls])
    radii = np.array([ball.radius for balls in spheres.values() for ball in balls])
    nearest = np.full(len(centers), np.inf)
    for first in range(0, len(world.rows), _BLOCK):
        nearest = np.minimum(nearest, distances(centers, world.rows[first : first + _BLOCK]).min(axis=1))
    return np.asarray(np.minimum(nearest - radii, MAX_CLEARANCE))
