"""Actions that move the robot: execute_trajectory (also as send_trajectory) and mpc_move."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from rclpy.action import CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from sensor_msgs.msg import JointState

from zarm.connection import ANSWER_SECONDS
from zarm_contract.errors import Busy, ExecutionRefused, InternalError, ZarmError, from_problem
from zarm_contract.messages import ExecuteRequest, ExecutorState, GoalState
from zarm_ros_bridge.arrivals import OrderedActionServer
from zarm_ros_bridge.closed_loop import CLOSED_LOOP, FEEDBACK_UNIT, ClosedLoop
from zarm_ros_bridge.convert.joints import ros_positions
from zarm_ros_bridge.convert.times import ros_time
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.generations.generation import Generation
from zarm_ros_bridge.goals import ASK_SECONDS, GOAL, Run, states_of
from zarm_ros_bridge.motions import Motions
from zarm_ros_bridge.parameters import Parameters
from zarm_ros_bridge.ros import REQUESTS, Ros

if TYPE_CHECKING:
    from curobo_msgs.action import SendTrajectory

log = logging.getLogger(__name__)

REST_SECONDS = 15.0
"""Longest wait (s) for the robot to come to rest when its goal is preempted."""
RESULT_SECONDS = 60
"""How long (s) a result can be requested."""
_END_SECONDS = 3.0
_JITTER = 0.05  # seconds by which a state of the executor may be early


class ExecutionActions:
    """The actions of one robot. Use it in `with`: leaving aborts the running goals, and the executor continues its goal
    alone.
    """

    def __init__(
        self, ros: Ros, engine: Engine, parameters: Parameters, motions: Motions, generation: Generation
    ) -> None:
        self._ros = ros
        self._engine = engine
        self._parameters = parameters
        self._motions = motions
        self._generation = generation
        self._turn = threading.Condition()
        self._running: Run | None = None
        self._newest: Run | None = None  # the one that came last
        self._servers: dict[str, OrderedActionServer] = {}
        self._closed_loop = ClosedLoop(ros, engine, parameters, generation)
        engine.client.connection.goals.listen()
        self._serve("SendTrajectory", "execute_trajectory", self._move)
        self._serve("SendTrajectory", "send_trajectory", self._move)
        self._serve("MpcMove", "mpc_move", self._closed_loop.move)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._engine.ending.set()
        if (run := self._running) is not None:
            run.leave()
            run.ended.wait(_END_SECONDS)

    def take_up_goals(self) -> None:
        """From now on continue the goals of a bridge that was killed: their clients hear of them again, and can cancel
        them.
        """
        self._engine.bus.watch(self._engine.keys.executor_state, self._take_up)

    def _take_up(self, _: str, state: ExecutorState) -> None:
        found = GOAL.fullmatch(state.goal_id or "")
        if found is not None and (server := self._servers.get(found["action"])) is not None:
            server.take_up(bytes.fromhex(found["id"]))

    def _serve(self, kind: str, name: str, move: Callable[[Run], str]) -> None:
        """`move` moves the robot for a goal of this action; it returns the success message."""
        if (action := self._generation.types.get(f"action/{kind}")) is None:
            return
        self._servers[name] = OrderedActionServer(
            self._ros.node,
            action,
            f"~/{name}",
            lambda handle: self._carry_out(action.Result, Run(handle, self._engine, name), move),
            goal_callback=self._admit,
            cancel_callback=self._cancel,
            callback_group=self._ros.group,
            goal_service_qos_profile=REQUESTS,
            cancel_service_qos_profile=REQUESTS,
            result_service_qos_profile=REQUESTS,
            result_timeout=RESULT_SECONDS,
        )

    def _admit(self, _: SendTrajectory.Goal) -> GoalResponse:
        """A rejection carries no reason; /rosout has it."""
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

    def _carry_out(self, result: type[Any], run: Run, move: Callable[[Run], str]) -> Any:
        """The result of a goal."""
        try:
            self._take_turn(run)
            message = move(run)
        except ZarmError as error:
            return result(success=False, message=self._failed(run, error))
        except Exception:  # as on the bus, one goal fails and the service continues
            log.exception("goal failed")
            fault = InternalError("the ROS bridge failed on this goal; its log has the trace")
            return result(success=False, message=self._failed(run, fault))
        else:
            run.handle.succeed()
            return result(success=True, message=message)
        finally:
            self._pass_turn(run)
            run.ended.set()

    def _failed(self, run: Run, error: ZarmError) -> str:
        """The message to the client of a goal that ends with this error."""
        level = logging.INFO if error.code == "cancelled" else logging.WARNING
        log.log(level, "goal not reached reason=%s: %s", error.code, error)
        if error.code == "cancelled" and run.cancelled():
            run.handle.canceled()
        else:
            run.handle.abort()
        if run.preempted:
            return "another goal took the place of this one, and the robot was brought to rest"
        return str(error)

    def _take_turn(self, run: Run) -> None:
        """Wait for the running goal to end if this one preempts it; the newest goal has the turn.

        Raises Busy if it does not preempt, or if the robot does not come to rest, and Cancelled if a later goal came.
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
        if preempt and (goal_id := client.state().goal_id) not in (None, run.name):  # of a client elsewhere
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


def _busy() -> str:
    return "another goal of this robot runs; cancel it first, or set the parameter preempt"
