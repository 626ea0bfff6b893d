"""Goals of clients, and the goals of the executor that they become, followed to their end."""

from __future__ import annotations

import logging
import secrets
import threading
import time
from collections import OrderedDict
from collections.abc import Iterator

from rclpy.action.server import ServerGoalHandle

from zarm_contract.errors import Cancelled, Unavailable, ZarmError
from zarm_contract.messages import CancelledPlan, CancelPlan, CancelRequest, ExecutorState, GoalState, Plan, PlanRequest
from zarm_ros_bridge.engine import Engine

log = logging.getLogger(__name__)

SILENCE = 5.0
"""Seconds without a word about a goal after which its executor is taken for gone."""
_ASK_AFTER = 1.0  # s without a publication after which the executor is asked; in motion it publishes at 10 Hz
_ASK_SECONDS = 1.0
_WAKE = 0.1  # s
_AGAIN = 1.0  # s after which a cancel that has had no effect is sent again
_NOTED = 5.0  # s from being told of a cancel to rclpy's note of it, at most: two questions are asked in between
_REMEMBERED = 64


class Goals:
    """What the executor says about its goals. Safe from any thread."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._states: OrderedDict[str, GoalState] = OrderedDict()
        self._changed = threading.Condition()
        self._ended = False
        engine.bus.watch(engine.keys.goal("*"), GoalState, lambda _, state: self._note(state))

    def states(self, goal_id: str) -> Iterator[GoalState]:
        """The goal's states up to its last one; where there is no new one, the same again ten times a second.

        Raises Unavailable where the executor has not been heard of for SILENCE s, and where this process ends.
        """
        seen: GoalState | None = None
        heard = asked = time.monotonic()
        while seen is None or not seen.done:
            state = self._next(goal_id, seen)
            if self._ended:
                raise Unavailable(f"the ROS bridge is ending; the goal {goal_id} of {self._robot} goes on without it")
            now = time.monotonic()
            if state is not seen:
                seen, heard = state, now
            elif now - heard > SILENCE:
                raise Unavailable(
                    f"the executor of {self._robot} has reported nothing about the goal {goal_id} for {SILENCE:g} s; whether the "
                    "robot still moves is not known: look at it, and at `zarm status`"
                )
            elif now - max(heard, asked) > _ASK_AFTER:
                self._ask(goal_id)
                asked = time.monotonic()
            if seen is not None:
                yield seen

    def cancel(self, goal_id: str | None) -> None:
        """Bring the robot to rest, if it is for this goal that it moves (None: any). Raises Unavailable."""
        self._engine.ask(self._engine.keys.cancel, ExecutorState, CancelRequest(goal_id=goal_id), timeout=_ASK_SECONDS)

    def end(self) -> None:
        """Nobody waits from now on."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()

    @property
    def _robot(self) -> str:
        return self._engine.keys.robot

    def _next(self, goal_id: str, seen: GoalState | None) -> GoalState | None:
        with self._changed:
            self._changed.wait_for(lambda: self._ended or self._states.get(goal_id, seen) is not seen, _WAKE)
            return self._states.get(goal_id, seen)

    def _ask(self, goal_id: str) -> None:
        try:
            state = self._engine.ask(self._engine.keys.goal(goal_id), GoalState, timeout=_ASK_SECONDS)
        except ZarmError:
            return  # it may be starting again; after SILENCE it is given up
        self._note(state)

    def _note(self, state: GoalState) -> None:
        with self._changed:
            known = self._states.get(state.goal_id)
            if known is not None and known.done:  # an answer that was overtaken by the last publication
                return
            self._states[state.goal_id] = state
            self._states.move_to_end(state.goal_id)
            if len(self._states) > _REMEMBERED:
                self._states.popitem(last=False)
            self._changed.notify_all()


class Run:
    """One goal of a client, from its turn to its result. Safe from any thread.

    `ended` is set when its outcome is certain; `preempted` says that another goal ended it.
    """

    def __init__(self, handle: ServerGoalHandle, engine: Engine, goals: Goals) -> None:
        self.handle = handle
        self.ended = threading.Event()
        self.preempted = False
        self._engine = engine
        self._goals = goals
        self._request_id = f"ros-{secrets.token_hex(4)}"
        self._planning = False
        self._goal_id: str | None = None
        self._cancelled = False
        self._stopped: float | None = None  # when it was told to last

    def cancel(self) -> None:
        """Its client wants it to end."""
        self._cancelled = True
        self._stop()

    def preempt(self) -> None:
        """Another goal takes its place."""
        self.preempted = True
        self._stop()

    def overtaken(self) -> Cancelled:
        """What ends it where another goal came before it had its turn."""
        self.preempted = True
        return Cancelled("another goal came before this one had begun")

    def leave(self) -> None:
        """This process ends: a planning is of no use any more, a motion goes on."""
        if self._goal_id is None:
            self._stop()

    def cancelled(self) -> bool:
        """Whether its client wanted it to end; if so, rclpy has noted it by the time that this returns."""
        deadline = time.monotonic() + _NOTED
        while self._cancelled and not self.handle.is_cancel_requested and time.monotonic() < deadline:
            time.sleep(0.005)
        return bool(self.handle.is_cancel_requested)

    def go_on(self) -> None:
        """Raises Cancelled where somebody wants it to end."""
        if self._stopped is not None or self.handle.is_cancel_requested:
            raise Cancelled("the goal was cancelled before the robot moved")

    def plan(self, request: PlanRequest, timeout: float) -> Plan:
        """The planner's answer. Raises what it answers, Cancelled where somebody wants the goal to end."""
        self._planning = True
        try:
            self.go_on()
            named = request.model_copy(update={"request_id": self._request_id})
            return self._engine.ask(self._engine.keys.plan, Plan, named, timeout=timeout)
        finally:
            self._planning = False

    def follow(self, goal_id: str) -> Iterator[GoalState]:
        """The states of the executor's goal that it has become. Raises Unavailable as `Goals.states` does."""
        self._goal_id = goal_id
        if self._stopped is not None:
            self._stop()
        for state in self._goals.states(goal_id):
            if self._stopped is not None and not state.done and time.monotonic() - self._stopped > _AGAIN:
                self._stop()
            yield state

    def _stop(self) -> None:
        self._stopped = time.monotonic()
        try:
            self._end_planning()
            if self._goal_id is not None:
                self._goals.cancel(self._goal_id)
        except ZarmError as error:  # sent again by `follow`, which gives up when the executor is gone
            log.warning("not cancelled goal_id=%s reason=%s", self._goal_id, error)

    def _end_planning(self) -> None:
        """Also where the request to plan is still on its way: the planner remembers that it was cancelled."""
        if self._planning:
            request = CancelPlan(request_id=self._request_id)
            self._engine.ask(self._engine.keys.plan_cancel, CancelledPlan, request, timeout=_ASK_SECONDS)
