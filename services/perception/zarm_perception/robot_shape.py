"""What is left out of depth images: the robot's exact geometry at measured joints, and things of the scene that it may grip."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from zarm_contract.messages import Mesh, SceneObject, Voxels
from zarm_geometry import packed_shapes
from zarm_geometry.robot_model import RobotModel
from zarm_perception.voxel_map import RobotShape
from zarm_trajectory.arrays import Array

GRIPPED = 0.25
"""The largest thing of the scene, by the ball around it (m), that is left out: it must not be in the way of a gripper."""


def known_things(objects: Sequence[SceneObject]) -> RobotShape:
    """The primitives among these that a robot may grip."""
    items = [item for item in objects if not isinstance(item, Mesh | Voxels)]
    parts = packed_shapes.primitives(items)
    x, y, z, disc, rounding = parts[:, 12:].T
    balls = np.column_stack(
        (np.array([item.position for item in items]).reshape(-1, 3), np.hypot(np.hypot(x, y) + disc, z) + rounding)
    )
    small = balls[:, 3] <= GRIPPED
    return RobotShape(parts[small], balls[small])


def _placed(pose: Array, extents: Array, radius: Array) -> RobotShape:
    """Shapes at poses (m, 4, 4) in the base frame."""
    turn = pose[:, :3, :3].transpose(0, 2, 1)
    frame = np.concatenate([turn, -turn @ pose[:, :3, 3:]], axis=2)
    return RobotShape(np.column_stack([frame.reshape(-1, 12), extents]), np.column_stack([pose[:, :3, 3], radius]))


class RobotShapes:
    """The convex parts of a model, which has what the robot carries and its grippers as they are, and `things` beside it."""

    def __init__(self, model: RobotModel, things: Sequence[SceneObject] = ()) -> None:
        self._model, self.things = model, known_things(things)
        self._link = np.array([link for link, _ in model.parts], np.intp)
        shapes = [shape for _, shape in model.parts]
        self._pose = np.array([shape.pose for shape in shapes]).reshape(-1, 4, 4)
        self._extents = np.array([(*shape.core, shape.disc, shape.rounding) for shape in shapes]).reshape(-1, 5)
        self._radius = np.array([shape.radius for shape in shapes])

    def at(self, joints: Array) -> RobotShape:
        """The parts at these joints (dof,)."""
        own = _placed(self._model.link_transforms(joints)[self._link] @ self._pose, self._extents, self._radius)
        return RobotShape(*(np.concatenate(pair) for pair in zip(own, self.things, strict=True)))
