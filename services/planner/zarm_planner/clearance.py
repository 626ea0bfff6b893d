"""How far one configuration is from what it is nearest to, and what that is: for messages, not for the hot path."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from zarm_planner.robot_model import RobotModel
from zarm_planner.world import World

Array = NDArray[np.float64]


def sphere_clearance(model: RobotModel, world: World, q: Array) -> tuple[float, tuple[str, str] | None]:
    """The smallest distance (m) of the robot's spheres at `q` (dof,) to the objects or to each other, and between whom.

    Negative is a depth of penetration; the world's margin is not counted. The pair is two links, or a link and an
    object; None (and an infinite distance) where nothing can meet.
    """
    centers = [
        pose[:3, :3] @ np.array([ball.center for ball in model.robot.descriptor.spheres[link]]).T + pose[:3, 3:]
        for link, pose in zip(model.links, model.link_transforms(q), strict=True)
    ]
    radii = [np.array([ball.radius for ball in model.robot.descriptor.spheres[link]]) for link in model.links]
    least, pair = math.inf, None
    for a, b in model.pairs:
        gaps = np.linalg.norm(centers[a][:, :, None] - centers[b][:, None, :], axis=0) - radii[a][:, None] - radii[b]
        if gaps.min() < least:
            least, pair = float(gaps.min()), (model.links[a], model.links[b])
    for link, name in enumerate(model.links):
        if model.link_joint[link] < 0 or not world.names:
            continue
        gaps = _distance(world.arrays.shapes.astype(np.float64), centers[link]) + world.margin - radii[link]
        if gaps.min() < least:
            least, pair = float(gaps.min()), (name, world.names[int(np.argmin(gaps.min(axis=1)))])
    return least, pair


def _distance(shapes: Array, points: Array) -> Array:
    """Signed distances (n, m) from shapes (n, 17), see WorldArrays, to points (3, m)."""
    frame = shapes[:, :12].reshape(-1, 3, 4)
    x, y, z = np.moveaxis(np.abs(frame[:, :, :3] @ points + frame[:, :, 3:]), 1, 0)
    half_x, half_y, half_z, radius, rounding = shapes[:, 12:].T[:, :, None]
    past_x, past_y, past_z = x - half_x, y - half_y, z - half_z
    rim = np.hypot(past_x, past_y) - radius
    across = np.where(radius > 0.0, np.maximum(rim, 0.0), np.hypot(np.maximum(past_x, 0.0), np.maximum(past_y, 0.0)))
    outside = np.hypot(across, np.maximum(past_z, 0.0))
    inside = np.minimum(np.maximum(np.where(radius > 0.0, rim, np.maximum(past_x, past_y)), past_z), 0.0)
    return np.asarray(outside + inside - rounding)
