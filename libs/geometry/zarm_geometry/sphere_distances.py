"""The distance of each of the robot's collision spheres to the scene."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.exact import FARTHEST
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.rows import distances
from zarm_geometry.world import World

Array = NDArray[np.float64]

_BLOCK = 4096
"""So many shapes of the scene are looked at together, for the sake of memory."""


def sphere_distances(model: RobotModel, world: World, q: Array) -> Array:
    """Distances (n,) in m of the descriptor's spheres to the nearest object at `q` (dof,), in the descriptor's order.

    Below 0 it is how deep the sphere is in one of the convex shapes that the objects consist of, and FARTHEST at most. All
    spheres are there, those of links that are fixed to the base or ignored too.
    """
    spheres = model.robot.descriptor.spheres
    poses = dict(zip(model.links, model.link_transforms(q), strict=True))
    centers = np.array([poses[link][:3] @ [*ball.center, 1.0] for link, balls in spheres.items() for ball in balls])
    radii = np.array([ball.radius for balls in spheres.values() for ball in balls])
    nearest = np.full(len(centers), np.inf)
    for first in range(0, len(world.rows), _BLOCK):
        nearest = np.minimum(nearest, distances(centers, world.rows[first : first + _BLOCK]).min(axis=1))
    return np.asarray(np.minimum(nearest - radii, FARTHEST))
