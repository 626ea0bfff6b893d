"""Actions that move the robot: execute_trajectory (also as send_trajectory) and mpc_move."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from rclpy.action.server import ServerGoalHandle
from sensor_msgs.msg import JointState

from zarm.connection import ANSWER_SECONDS
from zarm_contract.errors import ExecutionRefused, from_problem
from zarm_contract.messages import ExecuteRequest, GoalState
from zarm_ros_bridge.action_servers import Action, ActionServers
from zarm_ros_bridge.convert.joints import ros_positions
from zarm_ros_bridge.convert.times import ros_time
from zarm_ros_bridge.curobo.closed_loop import CLOSED_LOOP, FEEDBACK_UNIT, ClosedLoop
from zarm_ros_bridge.curobo.generations.generation import Generation
from zarm_ros_bridge.curobo.motions import Motions
from zarm_ros_bridge.curobo.parameters import Parameters
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.goals import Run
from zarm_ros_bridge.ros import Ros
from zarm_ros_bridge.turns import Turns, busy

if TYPE_CHECKING:
    from curobo_msgs.action import SendTrajectory

log = logging.getLogger(__name__)

_JITTER = 0.05  # seconds by which a state of the executor may be early


class ExecutionActions:
    """The actions of one robot."""

    def __init__(
        self,
        ros: Ros,
        engine: Engine,
        parameters: Parameters,
        motions: Motions,
        generation: Generation,
        servers: ActionServers,
        turns: Turns,
    ) -> None:
        self._ros = ros
        self._engine = engine
        self._parameters = parameters
        self._motions = motions
        self._generation = generation
        self._servers = servers
        self._turns = turns
        self._closed_loop = ClosedLoop(ros, engine, parameters, generation)
        self._serve("SendTrajectory", "execute_trajectory", self._move)
        self._serve("SendTrajectory", "send_trajectory", self._move)
        self._serve("MpcMove", "mpc_move", self._closed_loop.move)

    def _serve(self, kind: str, name: str, move: Callable[[Run], str]) -> None:
        """`move` moves the robot for a goal of this action; it returns the success message."""
        if (action := self._generation.types.get(f"action/{kind}")) is None:
            return
        self._servers.serve(
            self._ros,
            Action(
                action,
                f"~/{name}",
                name,
                lambda run: action.Result(success=True, message=move(run)),
                lambda _, text: action.Result(success=False, message=text),
                self._admit,
            ),
        )

    def _admit(self, _: SendTrajectory.Goal) -> bool:
        """A rejection carries no reason; /rosout has it."""
        if not (free := self._turns.free()):
            self._ros.node.get_logger().warning(f"A goal was rejected: {busy()}.")
        return free

    def _move(self, run: Run) -> str:
        """Plan if there is a target, and execute; or follow it, as the active planner does. Raises the services'
        errors.
        """
        if (planner := self._motions.planner) in CLOSED_LOOP and not run.taken_up:
            return self._closed_loop.execute(run, planner)
        feedback = _Feedback(
            run.handle, self._engine.joints, self._parameters.value("time_dilation_factor"), self._generation
        )
        for state in run.follow(self._start(run, feedback)):
            feedback.show(state)
        if state.problem is not None:
            raise self._engine.terms.of_error(from_problem(state.problem))
        return "Trajectory executed successfully"

    def _start(self, run: Run, feedback: _Feedback) -> str:
        """Start the executor goal for a client's goal, after planning if it has a target."""
        if run.taken_up:
            return run.name
        goal, motions = run.handle.request, self._motions
        asked = self._generation.goal(goal, motions.planner, self._engine.joints)
        if asked is None:
            motions.check_last()
            return self._started(run, ExecuteRequest())
        if goal.allow_cached and (plan := motions.made(asked)) is not None:
            try:
                return self._started(run, ExecuteRequest(plan_id=plan.plan_id))
            except ExecutionRefused as error:
                log.info("replanned plan_id=%s reason=%s", plan.plan_id, error)
        feedback.planning()
        return self._started(run, ExecuteRequest(plan_id=motions.plan(asked, run.plan).plan_id))

    def _started(self, run: Run, request: ExecuteRequest) -> str:
        run.go_on()
        return self._engine.client.start(
            request,
            goal_id=run.name,
            replan=self._parameters.value("replan_in_motion"),
            timeout=ANSWER_SECONDS,
        )


class _Feedback:
    """Reports the state of a goal to its client: every change, and during motion at the set cadence."""

    def __init__(
        self, handle: ServerGoalHandle, joints: tuple[str, ...], factor: float, generation: Generation
    ) -> None:
        self._handle = handle
        self._generation = generation
        self._joints = joints
        self._period = FEEDBACK_UNIT * factor - _JITTER
        self._shown: GoalState | None = None
        self._when = 0.0

    def planning(self) -> None:
        """Report that the goal is being planned."""
        self._report_progress("planning", 0.0, JointState())

    def show(self, state: GoalState) -> None:
        """Report a new or repeated state of the executor's goal."""
        before, now = self._shown, time.monotonic()
        if state is before or (before and state.status == before.status and now - self._when < self._period):
            return
        self._shown, self._when = state, now
        joint_command = ros_positions(self._joints, state.joint_command)
        joint_command.header.stamp = ros_time(time.time())
        self._report_progress(state.status, state.progress, joint_command)

    def _report_progress(self, state: str, progress: float, joint_command: JointState) -> None:
        kind = self._generation.types["action/SendTrajectory"].Feedback
        self._handle.publish_feedback(self._generation.feedback(kind, state, progress, joint_command))
