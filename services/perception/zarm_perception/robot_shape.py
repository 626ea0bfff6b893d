"""The robot's exact geometry at measured joints, as the filter of depth images takes it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.robot_model import RobotModel
from zarm_perception.voxel_map import RobotShape

Array = NDArray[np.float64]


class RobotShapes:
    """The convex parts of a model, which has what the robot carries and its grippers as they are."""

    def __init__(self, model: RobotModel) -> None:
        self._model = model
        self._link = np.array([link for link, _ in model.parts], np.intp)
        shapes = [shape for _, shape in model.parts]
        self._pose = np.array([shape.pose for shape in shapes]).reshape(-1, 4, 4)
        self._extents = np.array([(*shape.core, shape.disc, shape.rounding) for shape in shapes]).reshape(-1, 5)
        self._radius = np.array([shape.radius for shape in shapes])

    def at(self, joints: Array) -> RobotShape:
        """The parts at these joints (dof,)."""
        pose = self._model.link_transforms(joints)[self._link] @ self._pose
        turn = pose[:, :3, :3].transpose(0, 2, 1)
        frame = np.concatenate([turn, -turn @ pose[:, :3, 3:]], axis=2)
        parts = np.column_stack([frame.reshape(-1, 12), self._extents])
        return RobotShape(parts, np.column_stack([pose[:, :3, 3], self._radius]))
