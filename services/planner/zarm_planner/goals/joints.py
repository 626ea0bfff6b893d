"""Checks joint vectors from requests and from the robot."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from zarm_contract.errors import ExecutionRefused, InvalidRequest
from zarm_contract.messages import JointState
from zarm_geometry.robot_model import RobotModel
from zarm_runtime.bus import Latest
from zarm_trajectory.arrays import Array

MEASURED_AGE = 0.5
"""Seconds after which a measured state is too old to plan from."""
RANGE_SLACK = 0.01
"""Rad (m if prismatic) by which a joint may be outside its range, counting as at its limit.

Robots stop at, and measure, slightly more than their range; MoveIt's default is five times as much.
"""


class MeasuredJoints:
    """The published joints of the robot, in the descriptor's order."""

    def __init__(self, model: RobotModel, states: Latest[JointState]) -> None:
        self._joints = model.robot.descriptor.joints
        self._states = states

    def __call__(self) -> Array:
        """The current joints (dof,). Raises ExecutionRefused (`no_joint_state`)."""
        state = self._states.get(max_age=MEASURED_AGE)
        remedy = "start the executor of this robot, or give the joints in the request"
        if state is None:
            raise ExecutionRefused(
                f"no joint state was received within the last {MEASURED_AGE:g} s; {remedy}", code="no_joint_state"
            )
        position = dict(zip(state.joint_names, state.position, strict=True))
        for joint in self._joints:
            if joint not in position:
                raise ExecutionRefused(
                    f"the joint states lack {joint}, they have {', '.join(position)}; {remedy}",
                    code="no_joint_state",
                    joint=joint,
                )
        return np.array([position[joint] for joint in self._joints])


def checked(model: RobotModel, q: Sequence[float] | Array, field: str) -> Array:
    """A joint vector (dof,) of a request, positions or their derivatives. Raises InvalidRequest if its length is wrong."""
    joints = model.robot.descriptor.joints
    if len(q) != model.dof:
        raise InvalidRequest(
            f"{len(q)} values for the {model.dof} joints {', '.join(joints)}; give one for each", field=field
        )
    return np.array(q)


def within_range(model: RobotModel, q: Sequence[float] | Array, field: str) -> Array:
    """A joint vector (dof,) inside all joint ranges, at most RANGE_SLACK from `q`. Raises InvalidRequest."""
    values = checked(model, q, field)
    inside: Array = np.minimum(np.maximum(values, model.lower), model.upper)
    for i in np.flatnonzero(np.abs(values - inside) > RANGE_SLACK).tolist():
        joint = model.robot.descriptor.joints[i]
        raise InvalidRequest(
            f"{joint} at {values[i]:.4f} is outside its range, {model.lower[i]:.4f} to {model.upper[i]:.4f}; bring it "
            "back inside",
            field=f"{field}.{i}",
            joint=joint,
        )
    return inside
