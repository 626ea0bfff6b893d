"""What a motion along a curve has to do: which frame follows which curve, and how closely."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

import numpy as np

from zarm_contract.messages import CartesianGoal, PoseTolerance
from zarm_geometry.frames import pose_of
from zarm_geometry.robot_model import RobotModel
from zarm_planner.cartesian.curve import ToolCurve, tool_curve
from zarm_planner.cartesian.joint_curve import JointCurve
from zarm_planner.kernels.pose_region import COMPONENTS
from zarm_planner.kernels.tool_path import deviations_along
from zarm_planner.kinematics.pose_region import PoseRegion, tip_frame
from zarm_trajectory.arrays import Array

_FULL = 6
"""Joints, besides the last, beyond which an arm is redundant."""
DISTANCE = 1e-4
"""m by which the tip may leave the curve."""
ANGLE = math.radians(0.1)
"""rad by which its orientation may, beyond what the goal allows."""


@dataclass(frozen=True)
class ToolTask:
    """A curve, and the frame of the robot that follows it with the freedom of `region`."""

    curve: ToolCurve
    region: PoseRegion

    @classmethod
    def of(cls, model: RobotModel, goal: CartesianGoal, start: Array) -> Self:
        """The task of a goal, from the joints `start` (dof,). Raises InvalidRequest that names the field of the request."""
        tool = model.robot.descriptor.tool
        tolerance = PoseTolerance(orientation=goal.orientation_tolerance)
        joint, frame = tip_frame(model, goal.tip, "goal.tip")
        begin = model.fk_joint(joint, start) @ frame
        speeds = tool.speed, tool.acceleration, tool.rotational_speed
        curve = tool_curve(goal, begin, speeds, "goal")
        return cls(curve, PoseRegion.of(model, pose_of(begin), tolerance, goal.tip, "goal.tip"))

    @property
    def has_freedom(self) -> bool:
        """Whether there is more than one way to follow the curve from a configuration."""
        regions = self.region.arrays
        return int(regions.joint[0]) >= _FULL or bool(np.any(regions.tolerance[0, : COMPONENTS - 1] > 0.0))

    def use(self, parameters: Array, joints: Array) -> Array:
        """The share (n,) of the permitted deviation by which the frame at `joints` (n, dof) is off the curve at
        `parameters` (n,).
        """
        out = np.empty((len(joints), COMPONENTS))
        regions = self.region.arrays
        regions = regions._replace(pose=regions.pose.copy(), turn=regions.turn.copy(), shift=regions.shift.copy())
        deviations_along(regions, self.curve.poses(parameters), np.ascontiguousarray(joints), out)
        turned = np.maximum(np.abs(out[:, :3]) - regions.tolerance[0, :3], 0.0).max(axis=1)
        return np.asarray(np.maximum(out[:, 6] / DISTANCE, turned / ANGLE))

    def use_between(self, joints: JointCurve) -> float:
        """The largest use halfway between the stations of a curve of the joints."""
        worst = 0.0
        for stations, _, spline in joints.sections:
            middles = (stations[1:] + stations[:-1]) / 2.0
            worst = max(worst, float(self.use(middles, spline(middles)[:, : joints.dof]).max()))
        return worst
