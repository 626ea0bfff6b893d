"""Actions that move the robot: execute_trajectory, which is send_trajectory too, and mpc_move."""

from __future__ import annotations

import logging
import threading
import time
from types import TracebackType
from typing import Any, Self

from geometry_msgs.msg import Pose
from rclpy.action import CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle

from curobo_msgs.action import MpcMove, SendTrajectory
from zarm.connection import ANSWER_SECONDS
from zarm_contract.errors import Busy, InternalError, ZarmError, from_problem
from zarm_contract.messages import ExecuteRequest, GoalState, Plan, PlanRequest, PoseGoal
from zarm_ros_bridge.arrivals import OrderedActionServer
from zarm_ros_bridge.convert.joints import ros_positions
from zarm_ros_bridge.convert.poses import is_given, pose_of
from zarm_ros_bridge.convert.times import ros_time
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.goals import ASK_SECONDS, Run, states_of
from zarm_ros_bridge.parameters import Parameters
from zarm_ros_bridge.ros import REQUESTS, Ros

log = logging.getLogger(__name__)

FEEDBACK_UNIT = 0.2
"""Seconds between two feedbacks at a time_dilation_factor of 1."""
REST_SECONDS = 15.0
"""Longest wait for the rest of a robot whose goal is preempted."""
RESULT_SECONDS = 60
"""How long a result can be asked for."""
_NO_MPC = (
    "mpc_move is not available yet, because zarm has no closed-loop planner; use execute_trajectory with a target_pose"
)
_END_SECONDS = 3.0
_JITTER = 0.05  # s by which a state of the executor may be early


class ExecutionActions:
    """The actions of one robot. Use it in `with`: the end aborts what runs, and the executor goes on with it alone."""

    def __init__(self, ros: Ros, engine: Engine, parameters: Parameters) -> None:
        self._ros = ros
        self._engine = engine
        self._parameters = parameters
        self._turn = threading.Condition()
        self._running: Run | None = None
        self._newest: Run | None = None  # the one that came last
        engine.client.connection.goals.listen()
        self._serve(SendTrajectory, "execute_trajectory", self._execute, self._admit)
        self._serve(SendTrajectory, "send_trajectory", self._execute, self._admit)
        self._serve(MpcMove, "mpc_move", self._refuse, lambda _: GoalResponse.ACCEPT)
        ros.node.create_subscription(Pose, "~/mpc_goal", self._ignore, 1, callback_group=ros.group)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._engine.ending.set()
        if (run := self._running) is not None:
            run.leave()
            run.ended.wait(_END_SECONDS)

    def _serve(self, kind: Any, name: str, execute: Any, admit: Any) -> None:
        OrderedActionServer(  # which the node keeps
            self._ros.node,
            kind,
            f"~/{name}",
            execute,
            goal_callback=admit,
            cancel_callback=self._cancel,
            callback_group=self._ros.group,
            goal_service_qos_profile=REQUESTS,
            cancel_service_qos_profile=REQUESTS,
            result_service_qos_profile=REQUESTS,
            result_timeout=RESULT_SECONDS,
        )

    def _admit(self, _: SendTrajectory.Goal) -> GoalResponse:
        """A rejection carries no reason: /rosout does."""
        if self._running is None or self._parameters.value("preempt"):
            return GoalResponse.ACCEPT
        self._ros.node.get_logger().warning(f"A goal was rejected: {_busy()}.")
        return GoalResponse.REJECT

    def _cancel(self, handle: ServerGoalHandle) -> CancelResponse:
        """At once, in this thread: the one that follows the goal may be waiting."""
        run = self._running
        if run is not None and run.handle is handle:
            run.cancel()
        return CancelResponse.ACCEPT

    def _refuse(self, handle: ServerGoalHandle) -> MpcMove.Result:
        handle.abort()
        return MpcMove.Result(
            success=False,
            message=_NO_MPC,
        )

    def _ignore(self, _: Pose) -> None:
        self._ros.node.get_logger().warning(f"mpc_goal moves nothing: {_NO_MPC}.", once=True)

    def _execute(self, handle: ServerGoalHandle) -> SendTrajectory.Result:
        run = Run(handle, self._engine)
        try:
            self._take_turn(run)
            self._move(run)
        except ZarmError as error:
            return self._failed(run, error)
        except Exception:  # as on the bus: one goal fails, and the service goes on
            log.exception("goal failed")
            return self._failed(run, InternalError("the ROS bridge failed on this goal; its log has the trace"))
        else:
            handle.succeed()
            return SendTrajectory.Result(success=True, message="Trajectory executed successfully")
        finally:
            self._pass_turn(run)
            run.ended.set()

    def _failed(self, run: Run, error: ZarmError) -> SendTrajectory.Result:
        level = logging.INFO if error.code == "cancelled" else logging.WARNING
        log.log(level, "goal not reached reason=%s: %s", error.code, error)
        if error.code == "cancelled" and run.cancelled():
            run.handle.canceled()
        else:
            run.handle.abort()
        message = "another goal took the place of this one, and the robot was brought to rest" if run.preempted else ""
        return SendTrajectory.Result(success=False, message=message or str(error))

    def _take_turn(self, run: Run) -> None:
        """Wait for the goal that runs where this one preempts it; whichever came last has the turn.

        Raises Busy where it does not preempt, or where the robot does not come to rest, and Cancelled for a goal that came later.
        """
        preempt = self._parameters.value("preempt")
        with self._turn:
            other = self._running
            if other is not None and not preempt:
                raise Busy(_busy())
            if preempt and self._newest is not None and self._newest.handle.arrival > run.handle.arrival:
                raise run.overtaken()
            self._newest = run
            if other is None:
                self._running = run
            self._turn.notify_all()
        if other is not None:
            other.preempt()
            self._wait_for_turn(run)
        client = self._engine.client
        if preempt and (goal_id := client.state().goal_id) is not None:  # of a client elsewhere
            client.cancel(goal_id, timeout=ASK_SECONDS)
            for _ in states_of(self._engine, goal_id):
                run.go_on()

    def _wait_for_turn(self, run: Run) -> None:
        with self._turn:
            free = self._turn.wait_for(lambda: self._newest is not run or self._running is None, REST_SECONDS)
            if self._newest is not run:
                raise run.overtaken()
            if not free:
                raise Busy(_busy())
            self._running = run

    def _pass_turn(self, run: Run) -> None:
        with self._turn:
            if self._running is run:
                self._running = None
                self._turn.notify_all()

    def _move(self, run: Run) -> None:
        """Plan where there is a target, and execute. Raises what the planner or the executor answers."""
        feedback = _Feedback(run.handle, self._engine.joints, self._parameters.value("time_dilation_factor"))
        request = ExecuteRequest()
        if is_given(target := run.handle.request.target_pose):
            feedback.planning()
            request = ExecuteRequest(plan_id=self._plan(run, pose_of(target, "target_pose")).plan_id)
        run.go_on()
        for state in run.follow(self._engine.client.start(request, timeout=ANSWER_SECONDS)):
            feedback.show(state)
        if state.problem is not None:
            raise self._engine.terms.of_error(from_problem(state.problem))

    def _plan(self, run: Run, target: Any) -> Plan:
        value = self._parameters.value
        request = PlanRequest(
            goal=PoseGoal(kind="pose", position=target.position, orientation=target.orientation),
            planner="auto",
            timeout=value("timeout"),
            max_attempts=value("max_attempts"),
            margin=value("collision_activation_distance"),
        )
        return run.plan(request)


class _Feedback:
    """Tells a client how its goal is doing: every change, and in motion as often as the cadence allows."""

    def __init__(self, handle: ServerGoalHandle, joints: tuple[str, ...], factor: float) -> None:
        self._handle = handle
        self._joints = joints
        self._period = FEEDBACK_UNIT * factor - _JITTER
        self._shown: GoalState | None = None
        self._when = 0.0

    def planning(self) -> None:
        """Before there is anything to tell."""
        self._handle.publish_feedback(SendTrajectory.Feedback(state="planning"))

    def show(self, state: GoalState) -> None:
        """A state of the executor's goal, new or again."""
        before, now = self._shown, time.monotonic()
        if state is before or (before and state.status == before.status and now - self._when < self._period):
            return
        self._shown, self._when = state, now
        joint_command = ros_positions(self._joints, state.joint_command)
        joint_command.header.stamp = ros_time(time.time())
        self._handle.publish_feedback(
            SendTrajectory.Feedback(state=state.status, step_progression=state.progress, joint_command=joint_command)
        )


def _busy() -> str:
    return "another goal of this robot runs; cancel it first, or set the parameter preempt"
