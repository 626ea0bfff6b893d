"""Goals of clients and the executor goals behind them, followed to their end."""

from __future__ import annotations

import logging
import re
import secrets
import threading
import time
from collections.abc import Iterator

from rclpy.action.server import ServerGoalHandle

from zarm.interrupts import CtrlC
from zarm_contract.errors import Cancelled, Unavailable, ZarmError
from zarm_contract.messages import GoalState, Plan, PlanRequest, ProgramRequest
from zarm_ros_bridge.engine import Engine

log = logging.getLogger(__name__)

SILENCE = 5.0
"""Seconds without news of a goal after which its executor counts as gone."""
ASK_SECONDS = 1.0
"""Longest wait for the answer to a cancel."""
GOAL = re.compile("(?P<action>[a-z_]+)-(?P<id>[0-9a-f]{32})")
"""The name of the executor goal for a goal of this action, with its id on ROS."""
_CANCEL_RETRY_PERIOD = 1.0  # seconds after which a cancel without effect is sent again
_CANCEL_TIMEOUT = 5.0  # most seconds from a cancel request until rclpy records it: it answers two requests in between


def states_of(engine: Engine, goal_id: str) -> Iterator[GoalState]:
    """A goal's states up to its last one; if there is no new one, the same again ten times a second.

    Raises Unavailable if the executor has been silent for SILENCE s, or if this process ends.
    """
    return engine.client.connection.goals.states(goal_id, _Ending(engine, goal_id), silence=SILENCE)


class _Ending(CtrlC):
    """Interrupts those that follow a goal when the bridge ends."""

    def __init__(self, engine: Engine, goal_id: str) -> None:
        self._engine = engine
        self._goal_id = goal_id

    def check(self) -> None:
        """Raise Unavailable when the bridge ends."""
        if self._engine.ending.is_set():
            raise Unavailable(
                f"the ROS bridge is ending; the goal {self._goal_id} of {self._engine.keys.robot} goes on without it"
            )


class Run:
    """One goal of a client, from its turn to its result. Thread-safe.

    `ended` is set when its outcome is certain; `preempted` means that another goal ended it. If this bridge is killed,
    the next one recognises the goal by its `name` in the executor, as in `GOAL`, and continues it: it was then
    `taken_up`.
    """

    def __init__(self, handle: ServerGoalHandle, engine: Engine, action: str) -> None:
        self.handle = handle
        self.name = f"{action}-{bytes(handle.goal_id.uuid).hex()}"
        self.taken_up = handle.request is None
        self.ended = threading.Event()
        self.preempted = False
        self._engine = engine
        self._request_id = f"ros-{secrets.token_hex(4)}"
        self._planning = False
        self._goal_id: str | None = None
        self._cancelled = False
        self._stopped: float | None = None  # when it was last told to stop

    def cancel(self) -> None:
        """Its client cancels it."""
        self._cancelled = True
        self.stop()

    def preempt(self) -> None:
        """Another goal takes its place."""
        self.preempted = True
        self.stop()

    def overtaken(self) -> Cancelled:
        """The error of a goal replaced by another one before its turn."""
        self.preempted = True
        return Cancelled("another goal came before this one had begun")

    def leave(self) -> None:
        """This process is ending: stop planning, but let a motion continue."""
        if self._goal_id is None:
            self.stop()

    def cancelled(self) -> bool:
        """Whether its client cancelled it; if so, rclpy has recorded that when this returns."""
        deadline = time.monotonic() + _CANCEL_TIMEOUT
        while self._cancelled and not self.handle.is_cancel_requested and time.monotonic() < deadline:
            time.sleep(0.005)
        return bool(self.handle.is_cancel_requested)

    def go_on(self) -> None:
        """Raises Cancelled if the goal is to end."""
        if self._stopped is not None or self.handle.is_cancel_requested:
            raise Cancelled("the goal was cancelled before the robot moved")

    def plan(self, request: PlanRequest | ProgramRequest) -> Plan:
        """The planner's answer. Raises its error, and Cancelled if the goal is to end."""
        self._planning = True
        try:
            self.go_on()
            named = request.model_copy(update={"request_id": self._request_id})
            if isinstance(named, ProgramRequest):
                return self._engine.client.request_program(named)
            return self._engine.client.request_plan(named)
        finally:
            self._planning = False

    def becomes(self, goal_id: str) -> None:
        """From now on it corresponds to this goal of the executor, and ends with it."""
        self._goal_id = goal_id
        if self._stopped is not None:
            self.stop()

    def follow(self, goal_id: str) -> Iterator[GoalState]:
        """The states of its executor goal. Raises Unavailable as `states_of` does."""
        self.becomes(goal_id)
        for state in states_of(self._engine, goal_id):
            if self._stopped is not None and not state.done and time.monotonic() - self._stopped > _CANCEL_RETRY_PERIOD:
                self.stop()
            yield state

    def stop(self) -> None:
        """End its planning, or its motion."""
        self._stopped = time.monotonic()
        try:
            self._end_planning()
            if self._goal_id is not None:
                self._engine.client.cancel(self._goal_id, timeout=ASK_SECONDS)
        except ZarmError as error:  # sent again by `follow`, which gives up when the executor is gone
            log.warning("not cancelled goal_id=%s reason=%s", self._goal_id, error)

    def _end_planning(self) -> None:
        """Works even if the plan request is still on its way: the planner remembers the cancel."""
        if self._planning:
            self._engine.client.cancel_plan(self._request_id, timeout=ASK_SECONDS)
