"""The tolerances that a goal of follow_joint_trajectory brings along, beside those of the robot's descriptor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from zarm_contract.errors import ExecutionFailed, InvalidRequest
from zarm_contract.messages import GoalState
from zarm_ros_bridge.convert.times import NANOSECONDS


class GoalTolerances:
    """Those of a FollowJointTrajectory.Goal. As in ros2_control, 0 leaves a tolerance to the controller, and a negative one is none.

    Raises InvalidRequest for a joint that the trajectory does not move.
    """

    def __init__(self, goal: Any) -> None:
        names, last = goal.trajectory.joint_names, goal.trajectory.points[-1].positions
        self._end = dict(zip(names, last, strict=False))
        self._on_path = _positions(goal.path_tolerance, names, "path_tolerance")
        self._at_end = _positions(goal.goal_tolerance, names, "goal_tolerance")
        late = goal.goal_time_tolerance
        self._late = late.sec + late.nanosec / NANOSECONDS

    def check_motion(self, state: GoalState, measured: Mapping[str, float], joints: Sequence[str]) -> None:
        """Raises ExecutionFailed if a joint has left the trajectory, or the motion is late."""
        for joint, command in zip(joints, state.joint_command, strict=True):
            off = abs(command - measured[joint])
            if off > self._on_path.get(joint, off):
                raise ExecutionFailed(
                    f"{joint} is {off:.4f} rad off the trajectory", field="path_tolerance", joint=joint
                )
        if self._late > 0.0 and state.elapsed > state.duration + self._late:
            raise ExecutionFailed(
                f"the motion is more than {self._late:g} s late; the robot moves slower than the trajectory",
                field="goal_time_tolerance",
            )

    def check_end(self, measured: Mapping[str, float]) -> None:
        """Raises ExecutionFailed if a joint rests further from the end than it may."""
        for joint, tolerance in self._at_end.items():
            off = abs(self._end[joint] - measured[joint])
            if off > tolerance:
                raise ExecutionFailed(f"{joint} rests {off:.4f} rad from its goal", field="goal_tolerance", joint=joint)


def _positions(tolerances: Sequence[Any], names: Sequence[str], field: str) -> dict[str, float]:
    """The tolerances (rad) of positions by joint."""
    for index, one in enumerate(tolerances):
        if one.name not in names:
            raise InvalidRequest(
                f"{one.name!r} is not a joint of the trajectory; those are {', '.join(names)}",
                field=f"{field}[{index}].name",
            )
    return {one.name: one.position for one in tolerances if one.position > 0.0}
