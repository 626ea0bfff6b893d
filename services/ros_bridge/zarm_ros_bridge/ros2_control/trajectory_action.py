"""follow_joint_trajectory: the robot as a trajectory controller of ros2_control, for programs that plan elsewhere."""

from __future__ import annotations

import time
from typing import Any

from control_msgs.action import FollowJointTrajectory
from rclpy.action.server import ServerGoalHandle
from trajectory_msgs.msg import JointTrajectoryPoint

from zarm.connection import ANSWER_SECONDS
from zarm_contract.errors import Cancelled, ExecutionFailed, InvalidRequest, ZarmError, from_problem
from zarm_contract.messages import ExecuteRequest, GoalState
from zarm_ros_bridge.action_servers import Action, ActionServers
from zarm_ros_bridge.convert.joint_trajectories import starts_in, trajectory_of
from zarm_ros_bridge.convert.times import ros_time
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.frames import Frames
from zarm_ros_bridge.goals import Run
from zarm_ros_bridge.ros import Ros
from zarm_ros_bridge.ros2_control.goal_tolerances import GoalTolerances

NAME = "zarm_controller/follow_joint_trajectory"
"""Relative to the namespace of the bridge."""
_Result = FollowJointTrajectory.Result
_STEP = 0.02


class TrajectoryAction:
    """Serves the action. As for a controller of ros2_control, a new goal takes the place of the one that runs."""

    def __init__(self, ros: Ros, engine: Engine, frames: Frames, servers: ActionServers) -> None:
        self._engine = engine
        self._frames = frames
        self._log = ros.node.get_logger()
        servers.serve(
            ros,
            Action(FollowJointTrajectory, NAME, "follow_joint_trajectory", self._move, self._failed, replaces=True),
        )

    def _move(self, run: Run) -> Any:
        if run.taken_up:
            self._follow(run, None)
            return _Result(error_code=_Result.SUCCESSFUL)
        goal = run.handle.request
        if goal.multi_dof_trajectory.points:
            raise InvalidRequest(
                "the robot has no joints of several degrees of freedom; leave them out", field="multi_dof_trajectory"
            )
        if not goal.trajectory.points:  # hold: the goal before has come to rest
            return _Result(error_code=_Result.SUCCESSFUL)
        tolerances = GoalTolerances(goal)
        motion = trajectory_of(goal.trajectory, self._engine.joints, self._frames.joints, "trajectory")
        begin = time.monotonic() + starts_in(goal.trajectory, "trajectory")
        while (left := begin - time.monotonic()) > 0.0:
            run.go_on()
            time.sleep(min(_STEP, left))
        if motion is not None:
            run.go_on()
            self._engine.client.start(ExecuteRequest(trajectory=motion), goal_id=run.name, timeout=ANSWER_SECONDS)
            self._follow(run, _Watch(run.handle, self._engine, self._frames, tolerances))
        tolerances.check_end(dict(zip(self._engine.joints, self._frames.joints(), strict=True)))
        return _Result(error_code=_Result.SUCCESSFUL)

    def _follow(self, run: Run, watch: _Watch | None) -> None:
        fault: ExecutionFailed | None = None
        for state in run.follow(run.name):
            if watch is not None and fault is None:
                fault = watch.see(state)
                if fault is not None:
                    run.stop()
        if fault is not None:
            raise fault
        if state.problem is not None:
            raise self._engine.terms.of_error(from_problem(state.problem))
        if state.status != "succeeded":
            raise Cancelled("the motion was ended before the robot had reached the goal")

    def _failed(self, error: ZarmError, text: str) -> Any:
        self._log.warning(f"follow_joint_trajectory: {text}")
        return _Result(error_code=_code(error), error_string=text)


class _Watch:
    """Looks at each state of a goal: reports where the robot is, and tells when it leaves the goal's own tolerances."""

    def __init__(self, handle: ServerGoalHandle, engine: Engine, frames: Frames, tolerances: GoalTolerances) -> None:
        self._handle = handle
        self._joints = list(engine.joints)
        self._frames = frames
        self._tolerances = tolerances

    def see(self, state: GoalState) -> ExecutionFailed | None:
        """Report a state; returns how it breaks a tolerance, if it does."""
        try:
            desired, actual = list(state.joint_command), list(self._frames.joints())
        except ZarmError:  # the executor sees to a robot that does not report its joints
            return None
        self._report(desired, actual)
        if state.done:
            return None
        try:
            self._tolerances.check_motion(state, dict(zip(self._joints, actual, strict=True)), self._joints)
        except ExecutionFailed as fault:
            return fault
        return None

    def _report(self, desired: list[float], actual: list[float]) -> None:
        error = [a - b for a, b in zip(desired, actual, strict=True)] if desired else []
        feedback = FollowJointTrajectory.Feedback(
            joint_names=self._joints,
            desired=JointTrajectoryPoint(positions=desired),
            actual=JointTrajectoryPoint(positions=actual),
            error=JointTrajectoryPoint(positions=error),
        )
        feedback.header.stamp = ros_time(time.time())
        self._handle.publish_feedback(feedback)


def _code(error: ZarmError) -> int:
    """The code of control_msgs for an error; those that have none of their own are invalid goals."""
    field = error.problem.field or ""
    if error.code == "tolerance_violated":
        at_end = field.startswith("goal_") or "rests" in error.problem.message
        return int(_Result.GOAL_TOLERANCE_VIOLATED if at_end else _Result.PATH_TOLERANCE_VIOLATED)
    if field.endswith(("joint_names", "].name")):
        return int(_Result.INVALID_JOINTS)
    if field.endswith("header.stamp"):
        return int(_Result.OLD_HEADER_TIMESTAMP)
    return int(_Result.INVALID_GOAL)
