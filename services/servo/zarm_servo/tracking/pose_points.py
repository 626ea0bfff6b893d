"""Joint positions for poses that follow each other closely, by damped least squares from one to the next."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import Pose
from zarm_geometry.frames import matrix
from zarm_geometry.robot_model import RobotModel
from zarm_servo.tracking.targets import PoseTarget
from zarm_trajectory.arrays import Array

POSITION, ANGLE = 1e-4, 1e-3
"""A tip this close (m, rad) to a pose is there."""
_ROUNDS = 30
_DAMPING = 0.02
"""Of the inverse (Nakamura and Hanafusa, 1986)."""
_LARGEST = 0.3
"""A round moves no joint further than this (rad)."""


def joints_of(model: RobotModel, poses: Sequence[Pose], group: str | None, position: Array) -> Array:
    """The positions (N, J) at which the tip, of the `group`, is at the `poses`, the first one near `position` (J,) and each near the one before.

    Raises InvalidRequest for the first pose that cannot be reached from the one before.
    """
    found = np.empty((len(poses), model.dof))
    for index, pose in enumerate(poses):
        position = found[index] = _joints(model, pose, group, position, f"points.pose[{index}]")
    return found


def _joints(model: RobotModel, pose: Pose, group: str | None, position: Array, field: str) -> Array:
    target = PoseTarget(matrix(pose.position, pose.orientation), group=group)
    for _ in range(_ROUNDS):
        error = target.error(model.fk_tip(position, group), target.pose)
        off = float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))
        if off[0] < POSITION and off[1] < ANGLE:
            return position
        jacobian = model.tip_jacobian(position, group)
        step = jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + _DAMPING**2 * np.eye(6), error)
        step /= max(1.0, float(np.abs(step).max()) / _LARGEST)
        position = np.clip(position + step, model.lower, model.upper)
    raise InvalidRequest(
        f"from the pose before, the tip comes within {1e3 * off[0]:.1f} mm and {np.degrees(off[1]):.1f} deg of this one; "
        "send poses within reach, close to each other",
        field=field,
    )
