"""/diagnostics: what the robot's motion waits for, and whether a servo guards it."""

from __future__ import annotations

import time
from types import TracebackType
from typing import Self

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from zarm_contract.messages import ExecutorState, GoalState
from zarm_ros_bridge.convert.times import ros_time
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.holds import waiting
from zarm_ros_bridge.ros import Ros
from zarm_runtime.worker import Worker

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
        self._reported: DiagnosticStatus | None = None
        self._reported_at = 0.0
        self._worker = Worker("diagnostics", self._report, PERIOD)

    def __enter__(self) -> Self:
        self._worker.start()
        self._engine.bus.watch(self._engine.keys.executor_state, self._on_state)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._worker.stop()

    def _on_state(self, _key: str, state: ExecutorState) -> None:
        self._state = state
        self._worker.wake()

    def _report(self) -> float:
        """Publish if there is something to say; the time (s) until it is looked again."""
        state = self._state
        if state is None:
            return PERIOD
        status, now = self._status(state), time.monotonic()
        if status != self._reported or (now - self._reported_at >= PERIOD and self._executor_lives()):
            self._reported, self._reported_at = status, now
            message = DiagnosticArray(status=[status])
            message.header.stamp = ros_time(time.time())
            self._publisher.publish(message)
        return _POLL_PERIOD if state.goal_id is not None else PERIOD

    def _executor_lives(self) -> bool:
        return bool(self._engine.bus.alive(self._engine.keys.alive("executor", "*")))

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
