"""/diagnostics: what the robot's motion waits for, and whether a servo guards it."""

from __future__ import annotations

import threading
import time
from types import TracebackType
from typing import Self

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from zarm_contract.messages import ExecutorState, GoalState
from zarm_ros_bridge.convert.times import ros_time
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.holds import waiting
from zarm_ros_bridge.ros import Ros

DEPTH = 10
PERIOD = 1.0
"""Interval (s) of the status while nothing changes, as for `diagnostic_updater`."""
_POLL_PERIOD = 0.1
"""Interval (s) at which a running goal is checked, the same as that of the executor's reports."""


class Diagnostics:
    """Publishes one status, `<robot>: motion`, on change and every `PERIOD` s. Use it in `with`.

    ERROR is a fault, WARN a held goal or one without a guarding servo, OK anything else. Without an executor nothing is
    published, which tools show as stale.
    """

    def __init__(self, ros: Ros, engine: Engine) -> None:
        self._engine = engine
        self._publisher = ros.node.create_publisher(DiagnosticArray, "/diagnostics", DEPTH)
        self._state: ExecutorState | None = None
        self._changed = threading.Event()
        self._ended = False
        self._thread = threading.Thread(target=self._run, name="diagnostics")

    def __enter__(self) -> Self:
        self._thread.start()
        self._engine.bus.watch(self._engine.keys.executor_state, self._on_state)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended = True
        self._changed.set()
        self._thread.join()

    def _on_state(self, _key: str, state: ExecutorState) -> None:
        self._state = state
        self._changed.set()

    def _run(self) -> None:
        reported, reported_at = None, 0.0
        executor = self._engine.keys.alive("executor", "*")
        while not self._ended:
            state = self._state
            if state is not None:
                status, now = self._status(state), time.monotonic()
                if status != reported or (now - reported_at >= PERIOD and self._engine.bus.alive(executor)):
                    reported, reported_at = status, now
                    message = DiagnosticArray(status=[status])
                    message.header.stamp = ros_time(time.time())
                    self._publisher.publish(message)
            self._changed.wait(_POLL_PERIOD if state is not None and state.goal_id is not None else PERIOD)
            self._changed.clear()

    def _status(self, state: ExecutorState) -> DiagnosticStatus:
        engine = self._engine
        goal = engine.goal(state)
        level, message = _said(state, goal)
        found = None if goal is None or goal.hold is None else goal.hold.obstruction
        values = {
            "mode": state.mode,
            "strategy": state.strategy,
            "goal_id": state.goal_id or "",
            "guarded": str(state.guarded),
            "object": "" if found is None else found.object,
            "link": "" if found is None else found.link,
        }
        return DiagnosticStatus(
            level=level,
            name=f"{engine.keys.robot}: motion",
            message=engine.terms.of(message),
            hardware_id=engine.keys.robot,
            values=[KeyValue(key=key, value=value) for key, value in values.items()],
        )


def _said(state: ExecutorState, goal: GoalState | None) -> tuple[bytes, str]:
    """The level and the message."""
    if state.problem is not None:
        return DiagnosticStatus.ERROR, state.problem.message
    if held := waiting(goal):
        return DiagnosticStatus.WARN, held
    if state.goal_id is not None and not state.guarded:
        return (
            DiagnosticStatus.WARN,
            "no servo watches the goal that runs; it does not stop for what comes into its way",
        )
    return DiagnosticStatus.OK, state.mode
