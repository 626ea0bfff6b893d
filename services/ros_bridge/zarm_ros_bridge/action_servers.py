"""Action servers whose goals move the robot, one at a time."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

from rclpy.action import CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle

from zarm_contract.errors import InternalError, ZarmError
from zarm_contract.messages import ExecutorState
from zarm_ros_bridge.arrivals import OrderedActionServer
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.goals import GOAL, Run
from zarm_ros_bridge.ros import REQUESTS, Ros
from zarm_ros_bridge.turns import Turns

log = logging.getLogger(__name__)

RESULT_SECONDS = 60
"""How long (s) a result can be requested."""
_END_SECONDS = 3.0


@dataclass(frozen=True)
class Action:
    """An action: its type, its name on ROS, and what is done for a goal.

    `move` carries a goal out and returns its result, or raises ZarmError; `failed` makes the result from the error and its text.
    `key` begins the names of its goals in the executor. Goals for which `moves` is false do not move the robot, and need no turn.
    With `replaces` a goal always takes the place of the one that runs.
    """

    kind: type[Any]
    name: str
    key: str
    move: Callable[[Run], Any]
    failed: Callable[[ZarmError, str], Any]
    admit: Callable[[Any], bool] = lambda _: True
    moves: Callable[[Any], bool] = lambda _: True
    replaces: bool = False


class ActionServers:
    """The actions of one robot. Use it in `with`: leaving aborts the running goals, and the executor continues its goal
    alone.
    """

    def __init__(self, engine: Engine, turns: Turns) -> None:
        self._engine = engine
        self._turns = turns
        self._runs: dict[int, Run] = {}  # by the identity of the handle
        self._servers: dict[str, OrderedActionServer] = {}
        engine.client.connection.goals.listen()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._engine.ending.set()
        for run in list(self._runs.values()):
            run.leave()
            run.ended.wait(_END_SECONDS)

    def take_up_goals(self) -> None:
        """From now on continue the goals of a bridge that was killed: their clients hear of them again, and can cancel
        them.
        """
        self._engine.bus.watch(self._engine.keys.executor_state, self._take_up)

    def serve(self, ros: Ros, action: Action) -> None:
        """Serve an action on the node of `ros`. Call before `spin`."""
        self._servers[action.key] = OrderedActionServer(
            ros.node,
            action.kind,
            action.name,
            lambda handle: self._carry_out(action, Run(handle, self._engine, action.key)),
            goal_callback=lambda goal: GoalResponse.ACCEPT if action.admit(goal) else GoalResponse.REJECT,
            cancel_callback=self._cancel,
            callback_group=ros.group,
            goal_service_qos_profile=REQUESTS,
            cancel_service_qos_profile=REQUESTS,
            result_service_qos_profile=REQUESTS,
            result_timeout=RESULT_SECONDS,
        )

    def _take_up(self, _: str, state: ExecutorState) -> None:
        found = GOAL.fullmatch(state.goal_id or "")
        if found is not None and (server := self._servers.get(found["action"])) is not None:
            server.take_up(bytes.fromhex(found["id"]))

    def _cancel(self, handle: ServerGoalHandle) -> CancelResponse:
        """At once, in this thread: the one that follows the goal may be waiting."""
        if (run := self._runs.get(id(handle))) is not None:
            run.cancel()
        return CancelResponse.ACCEPT

    def _carry_out(self, action: Action, run: Run) -> Any:
        """The result of a goal."""
        self._runs[id(run.handle)] = run
        try:
            if run.taken_up or action.moves(run.handle.request):
                self._turns.take(run, preempt=action.replaces or None)
            result = action.move(run)
        except ZarmError as error:
            return action.failed(error, self._failed(run, error))
        except Exception:  # as on the bus, one goal fails and the service continues
            log.exception("goal failed")
            fault = InternalError("the ROS bridge failed on this goal; its log has the trace")
            return action.failed(fault, self._failed(run, fault))
        else:
            run.handle.succeed()
            return result
        finally:
            self._turns.pass_on(run)
            del self._runs[id(run.handle)]
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
