"""Goals in closed loop: the servo makes the robot follow a target that may move."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from geometry_msgs.msg import Pose as RosPose
from sensor_msgs.msg import JointState as RosJointState

from zarm.servoing import Tracking, limited
from zarm_contract.errors import Cancelled, DeadlineExceeded, InvalidRequest, Unavailable, ZarmError
from zarm_contract.messages import Pose
from zarm_ros_bridge.convert.joints import is_empty, ros_positions
from zarm_ros_bridge.convert.poses import is_given, pose_of
from zarm_ros_bridge.convert.times import ros_time
from zarm_ros_bridge.curobo.convergence import Approach, Convergence
from zarm_ros_bridge.curobo.generations.generation import Generation
from zarm_ros_bridge.curobo.live_target import LiveTarget
from zarm_ros_bridge.curobo.motion_requests import MotionRequest
from zarm_ros_bridge.curobo.parameters import Parameters
from zarm_ros_bridge.curobo.predicted_path import PredictedPath
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.goals import Run
from zarm_ros_bridge.ros import Ros

CLOSED_LOOP = ("mpc", "retarget")
"""The planners that work in closed loop, and make no trajectory."""
FEEDBACK_UNIT = 0.2
"""Seconds between two feedbacks at a time_dilation_factor of 1."""
_WARN_SECONDS = 5.0


@dataclass(frozen=True)
class _Steps:
    """Parameters for following a goal, read when it begins."""

    step: float
    horizon: int
    most: int
    feedback: float
    approach: Approach


class ClosedLoop:
    """Follows one goal at a time. `mpc_goal` moves the target of the current one."""

    def __init__(self, ros: Ros, engine: Engine, parameters: Parameters, generation: Generation) -> None:
        self._engine = engine
        self._value = parameters.value
        self._generation = generation
        self._live: LiveTarget | None = None
        self._path = PredictedPath(ros, engine)
        self._log = ros.node.get_logger()
        ros.listen(RosPose, ros.node.resolve_topic_name("~/mpc_goal"), self._retarget, 1)

    def execute(self, run: Run, planner: str) -> str:
        """Carry out a goal of execute_trajectory: follow its target, or hold the tip's pose if it has none, until it is
        ended.

        Raises the error it ends with: Cancelled if its client cancels it.
        """
        generation = self._generation
        asked = generation.goal(run.handle.request, planner, self._engine.joints)
        kind = generation.types["action/SendTrajectory"].Feedback

        def publish(state: str, convergence: Convergence, joint_command: RosJointState) -> None:
            run.handle.publish_feedback(
                generation.feedback(kind, state, convergence.progress, joint_command, convergence)
            )

        target = self._engine.client.tip() if asked is None else _one_pose(asked, planner)
        try:
            return self._follow(run, LiveTarget(target, timed=planner == "retarget"), publish, ends_on_target=False)
        except ZarmError as error:
            if error.code != "cancelled":
                publish("aborted", Convergence(), RosJointState())
            raise

    def move(self, run: Run) -> str:
        """Carry out a goal of mpc_move: follow its target until the robot is there; returns the message for the client.

        Raises the error it ends with, DeadlineExceeded after `max_mpc_iterations` steps.
        """
        target = run.handle.request.target_pose
        if not is_given(target):
            raise InvalidRequest("there is no goal; fill in target_pose", field="target_pose")
        kind = self._generation.types["action/MpcMove"].Feedback

        def publish(_: str, convergence: Convergence, joint_command: RosJointState) -> None:
            run.handle.publish_feedback(kind(joint_command=joint_command, step_progression=convergence.progress))

        return self._follow(run, LiveTarget(pose_of(target, "target_pose"), timed=False), publish, ends_on_target=True)

    def _follow(
        self,
        run: Run,
        live: LiveTarget,
        publish: Callable[[str, Convergence, RosJointState], None],
        *,
        ends_on_target: bool,
    ) -> str:
        """Lead the robot, and bring it to rest at the end. Raises the session's error, in terms of ROS."""
        steps = self._steps()
        run.go_on()
        try:
            with self._engine.client.track() as tracking, self._target_published(live, steps):
                run.becomes(tracking.goal_id)
                began = reported_at = time.monotonic()
                reported = ""
                while True:
                    if live.lead(tracking):
                        steps.approach.begin()
                    self._check(tracking)
                    now = time.monotonic()
                    convergence = steps.approach.judge(live.reported_session(tracking.state), now)
                    there = ends_on_target and convergence.on_target
                    state = "on_target" if convergence.on_target else "tracking"
                    if there or state != reported or now - reported_at >= steps.feedback:
                        reported, reported_at = state, now
                        publish(state, convergence, self._joint_command(tracking))
                    if there:
                        return f"Target reached: {_left(convergence)}"
                    if ends_on_target and now - began > steps.most * steps.step:
                        raise DeadlineExceeded(
                            f"the target is not reached after {steps.most} steps of {steps.step:g} s (max_mpc_iterations): "
                            f"{limited(tracking.state)}; {_left(convergence)}"
                        )
        except ZarmError as error:
            raise self._engine.terms.of_error(error) from error

    @contextmanager
    def _target_published(self, live: LiveTarget, steps: _Steps) -> Iterator[None]:
        """A block in which `mpc_goal` moves this target."""
        with self._path.shown(live, steps.horizon, steps.step):
            self._live = live
            try:
                yield
            finally:
                self._live = None

    def _steps(self) -> _Steps:
        value = self._value
        first = self._generation.letter == "a"  # generation A has other names for these two
        step = 1.0 / value("mpc_control_frequency") if first else value("mpc_step_dt")
        return _Steps(
            step=step,
            horizon=value("mpc_horizon") if first else value("mpc_horizon_steps"),
            most=value("max_mpc_iterations"),
            feedback=max(0.1, FEEDBACK_UNIT * value("time_dilation_factor")),
            approach=Approach(
                position=value("convergence_threshold"),
                orientation=value("convergence_threshold_rad"),
                hold_steps=value("convergence_hold_steps"),
                step=step,
            ),
        )

    def _check(self, tracking: Tracking) -> None:
        """Raises Unavailable if the bridge is ending, and Cancelled if someone else has ended the session."""
        if self._engine.ending.is_set():
            raise Unavailable("the ROS bridge ends, and brings the robot to rest; send the goal again when it is back")
        if not tracking.running:
            raise Cancelled(
                "another client has ended the session of the servo; see who leads the robot, then send it again"
            )

    def _joint_command(self, tracking: Tracking) -> RosJointState:
        goal = self._engine.client.connection.goals.known(tracking.goal_id)
        joint_command = ros_positions(self._engine.joints, () if goal is None else goal.joint_command)
        joint_command.header.stamp = ros_time(time.time())
        return joint_command

    def _retarget(self, message: RosPose) -> None:
        live = self._live
        if live is None:
            self._warn(
                "mpc_goal moves nothing: no goal in closed loop runs. Send one of mpc_move, or of execute_trajectory with the "
                "planner mpc or retarget."
            )
            return
        try:
            live.put(pose_of(message, "mpc_goal"))
        except ZarmError as error:
            self._warn(f"mpc_goal is not followed: {error}")

    def _warn(self, text: str) -> None:
        self._log.warning(text, throttle_duration_sec=_WARN_SECONDS)


def check_plans(planner: str) -> None:
    """Raises InvalidRequest for a planner that makes no trajectory."""
    if planner in CLOSED_LOOP:
        raise InvalidRequest(
            f"the planner {planner} runs in closed loop and makes no trajectory; send a goal of execute_trajectory or mpc_move, or choose "
            "another planner with set_planner",
            field="planner_type",
        )


def _one_pose(asked: MotionRequest, planner: str) -> Pose:
    """The target. Raises InvalidRequest unless the request is for one pose from the present robot position."""
    if not is_empty(asked.start):
        raise InvalidRequest(
            f"the planner {planner} starts where the robot is; leave start_pose empty", field="start_pose"
        )
    poses = [pose for poses in asked.sets for pose in poses]
    if len(poses) != 1:
        raise InvalidRequest(
            f"the planner {planner} follows one pose; give one target, and move it by mpc_goal", field=asked.field
        )
    return poses[0]


def _left(convergence: Convergence) -> str:
    return f"{1e3 * convergence.position_error:.1f} mm and {convergence.orientation_error:.3f} rad are left"
