"""Grippers as groups of MoveIt: `hand.set_named_target("open")`, planned and executed like an arm's motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from moveit_msgs.msg import MoveItErrorCodes as Val
from moveit_msgs.msg import RobotTrajectory
from trajectory_msgs.msg import JointTrajectoryPoint

from zarm_contract.gripper import Gripper
from zarm_contract.messages import GripperState
from zarm_ros_bridge.convert.fields import finite
from zarm_ros_bridge.convert.times import ros_duration
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.goals import Run
from zarm_ros_bridge.moveit.error_codes import Refusal
from zarm_ros_bridge.moveit.states import robot_state

_SLACK = 1e-3
"""By how much a position may be outside of the range (rad, m) and counts as its end."""


@dataclass(frozen=True)
class GripperMotion:
    """The motion of a gripper in MoveIt's messages."""

    start: Any
    trajectory: Any


class GripperGroups:
    """The groups of a robot's grippers, each with the name of the gripper and its joints."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        urdf = engine.robot.urdf
        self._grippers = engine.robot.descriptor.grippers
        self._joints = {name: gripper.joints(urdf) for name, gripper in self._grippers.items()}

    def __contains__(self, group: object) -> bool:
        return group in self._grippers

    def plan(self, request: Any) -> GripperMotion:
        """The motion to the joint constraints of a `MotionPlanRequest` for the group of a gripper. Raises Refusal."""
        name = request.group_name
        gripper, joints = self._grippers[name], self._joints[name]
        wanted = [constraint for goal in request.goal_constraints[:1] for constraint in goal.joint_constraints]
        known = [one for one in wanted if one.joint_name in joints]
        if len(known) != len(wanted) or not known:
            raise Refusal(
                Val.INVALID_GOAL_CONSTRAINTS,
                f"a goal of {name} has joint constraints of {', '.join(joints)}",
                "goal_constraints[0].joint_constraints",
            )
        field = "goal_constraints[0].joint_constraints[0].position"
        end = _inside(gripper, self._driven(name, known[0].joint_name, finite(known[0].position, field)), field)
        measured = self._engine.client.gripper.state(name).position
        begin = gripper.positions[-1] if measured is None else measured
        duration = abs(end - begin) / (gripper.speed * gripper.joint_speed)
        return GripperMotion(self._state(name, begin), self._trajectory(name, begin, end, duration))

    def of_trajectory(self, names: Sequence[str]) -> str | None:
        """The gripper that a trajectory of these joints moves; None if it is none."""
        return next((name for name, joints in self._joints.items() if names and set(names) <= set(joints)), None)

    def execute(self, name: str, trajectory: Any, run: Run) -> GripperState:
        """Move a gripper to the end of a trajectory of its joints. Raises Refusal, and the executor's errors."""
        points = trajectory.points
        if not points:
            return self._engine.client.gripper.state(name)
        field = f"trajectory.joint_trajectory.points[{len(points) - 1}].positions[0]"
        end = self._driven(name, trajectory.joint_names[0], finite(points[-1].positions[0], field))
        gripper = self._grippers[name]
        width = gripper.width(_inside(gripper, end, field))
        return self._engine.client.gripper.move(width, name, preempt=True, on_progress=lambda _: run.go_on())

    def _driven(self, name: str, joint: str, position: float) -> float:
        """The position of the driven joint with one of the gripper's joints there."""
        multiplier, offset = self._joints[name][joint]
        return (position - offset) / multiplier

    def _positions(self, name: str, driven: float) -> list[float]:
        return [multiplier * driven + offset for multiplier, offset in self._joints[name].values()]

    def _state(self, name: str, driven: float) -> Any:
        return robot_state(list(self._joints[name]), self._positions(name, driven))

    def _trajectory(self, name: str, begin: float, end: float, duration: float) -> Any:
        made = RobotTrajectory()
        made.joint_trajectory.joint_names = list(self._joints[name])
        still = [0.0] * len(self._joints[name])
        made.joint_trajectory.points = [
            JointTrajectoryPoint(
                positions=self._positions(name, at), velocities=still, time_from_start=ros_duration(time)
            )
            for at, time in ((begin, 0.0), (end, max(duration, 1e-3)))
        ]
        return made


def _inside(gripper: Gripper, position: float, field: str) -> float:
    low, high = sorted((gripper.positions[0], gripper.positions[-1]))
    if not low - _SLACK <= position <= high + _SLACK:
        raise Refusal(
            Val.INVALID_GOAL_CONSTRAINTS,
            f"{position:g} is outside of the range of {gripper.joint}, {low:g} to {high:g}; give one inside",
            field,
        )
    return min(max(position, low), high)
