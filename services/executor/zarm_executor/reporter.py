"""Publishes the state of the state machine: every change at once, and progress during motion."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable

from zarm_contract.errors import ExecutionFailed, Problem
from zarm_contract.keys import Keys
from zarm_contract.messages import ExecutorState, GoalState
from zarm_executor.goal import Goal
from zarm_executor.machine import Machine
from zarm_runtime import clock
from zarm_runtime.bus import Bus
from zarm_runtime.metrics import Metrics
from zarm_runtime.state_file import StateFile

log = logging.getLogger(__name__)

PERIOD = 0.02
"""Interval (s) at which the machine is polled for changes not caused by a command."""
REST_PERIOD = 0.1
"""The same without a goal (s)."""
PROGRESS_PERIOD = 0.1
"""Interval (s) at which the state of a moving goal is published."""
MISSED_TICKS_PERIOD = 1.0
"""Least interval (s) at which the executor's state is published only because of missed ticks."""
ENDS = ("succeeded", "cancelled", "aborted")
"""Final states of a goal."""
FINISHED_GOALS = 32
"""Number of ended goals that remain queryable."""


class Reporter:
    """Publishes `executor/state`, `executor/goal/<goal_id>` and `executor/trajectory`, and keeps the running goal in
    `running` for a restart.

    `lateness()` is the greatest lateness of a tick since last asked. `on_fault(problem)` is called once everything that
    led to a fault has been published.
    """

    def __init__(
        self,
        bus: Bus,
        keys: Keys,
        joints: tuple[str, ...],
        machine: Machine,
        running: StateFile[GoalState],
        lateness: Callable[[], float],
        on_fault: Callable[[Problem], None],
        metrics: Metrics,
    ) -> None:
        self._keys = keys
        self._joints = joints
        self._machine = machine
        self._running = running
        self._lateness = lateness
        self._on_fault = on_fault
        self._metrics = metrics
        for status in ENDS:
            self._count_goal(status, 0)
        for code in ExecutionFailed.codes:
            self._count_fault(code, 0)
        self._states = bus.latched(keys.executor_state)
        self._goals = bus.latched(keys.goal("*"))
        self._trajectories = bus.latched(keys.goal_trajectory)
        self._finished: deque[str] = deque()
        self._state: ExecutorState | None = None
        self._published_state = 0.0
        self._published_progress = 0.0
        self._lock = threading.Lock()

    def report_interrupted(self) -> None:
        """Report the goal left running by an earlier process, if any, as aborted."""
        left = self._running.load()
        if left is not None:
            problem = Problem(
                code="unavailable",
                message="the executor ended while this goal ran, and does not resume it; plan again from where the robot is",
            )
            with self._lock:
                self._publish_goal(left.model_copy(update={"status": "aborted", "problem": problem}))

    def knows(self, goal_id: str) -> bool:
        """Whether this is one of the last ended goals."""
        with self._lock:
            return goal_id in self._finished

    def report(self, goal: GoalState) -> None:
        """Publish the end of a goal that never began, whatever is running."""
        with self._lock:
            self._set_goal(goal)

    def remember(self, goal: GoalState) -> None:
        """Record a goal before it moves, so that a restart can report it. Raises Unavailable."""
        self.publish()  # takes the previous goal off the record
        self._running.save(goal)

    def show(self, goal: Goal) -> None:
        """From now on publish what is followed for this goal."""
        self._trajectories.set(goal.followed(self._joints))

    def forget(self) -> None:
        """Take a goal off the record that was not started after all."""
        self._running.clear()

    def look(self, now: float) -> None:
        """Publish changes; `now` is on the monotonic clock. If there is no goal, wait up to `REST_PERIOD` for one."""
        self.publish(now)
        self._machine.wait_for_news(REST_PERIOD)

    def publish(self, now: float | None = None) -> ExecutorState:
        """Publish changes, and return the state that is now on the bus; `now` is on the monotonic clock.

        A command handler calls this before it answers, so no answer is ahead of the published state. The state is not
        ahead of the goals either, so whoever sees the robot idle can read how its goal ended.
        """
        now = clock.monotonic() if now is None else now
        with self._lock:
            changes, state = self._machine.news()
            for change in changes:
                self._publish_goal(change)
                self._published_progress = now
            if now - self._published_progress >= PROGRESS_PERIOD - PERIOD / 2:
                goal = self._machine.goal_state()
                if goal is not None and not self._machine.changes:
                    goal = goal.model_copy(update={"tick_lateness": self._lateness()})
                    self._goals.set(goal, key=self._keys.goal(goal.goal_id))
                    self._published_progress = now
            return self._publish_state(state, now)

    def _publish_goal(self, goal: GoalState) -> None:
        self._set_goal(goal)
        if goal.done:
            self.forget()

    def _set_goal(self, goal: GoalState) -> None:
        self._goals.set(goal, key=self._keys.goal(goal.goal_id))
        _log("goal goal_id=%s status=%s", goal.goal_id, goal.status, problem=goal.problem)
        if not goal.done:
            return
        self._count_goal(goal.status, 1)
        self._finished.append(goal.goal_id)
        if len(self._finished) > FINISHED_GOALS:
            self._goals.forget(self._keys.goal(self._finished.popleft()))

    def _publish_state(self, state: ExecutorState, now: float) -> ExecutorState:
        before = self._state
        if state == before:
            return state
        if before is None or state != before.model_copy(update={"missed_ticks": state.missed_ticks}):
            _log("state mode=%s strategy=%s", state.mode, state.strategy, problem=state.problem)
            if state.scene_changed and not (before and before.scene_changed and before.goal_id == state.goal_id):
                log.warning(
                    "the scene has changed since this motion was checked goal_id=%s remedy=%s",
                    state.goal_id,
                    "stop it, and plan again, if something is in its way",
                )
        elif now - self._published_state < MISSED_TICKS_PERIOD:
            return state
        self._states.set(state)
        if state.mode == "fault" and state.problem is not None and (before is None or before.problem != state.problem):
            self._count_fault(state.problem.code, 1)
            self._on_fault(state.problem)
        self._state, self._published_state = state, now
        return state

    def _count_goal(self, status: str, by: int) -> None:
        self._metrics.count("zarm_goals", "Goals that ended, by their status.", by, status=status)

    def _count_fault(self, code: str, by: int) -> None:
        self._metrics.count("zarm_faults", "Faults, by the code of the problem.", by, code=code)


def _log(event: str, *values: object, problem: Problem | None) -> None:
    if problem is None:
        log.info(event, *values)
    else:
        level = logging.INFO if problem.code == "cancelled" else logging.WARNING
        log.log(level, f"{event} reason=%s", *values, f"{problem.code}: {problem.message}")
