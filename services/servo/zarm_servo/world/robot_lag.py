"""How much later than its commands the robot moves, as the executor measures it."""

from __future__ import annotations

from collections import deque

from zarm_contract.messages import ExecutorState, GoalState

_REPORTS_KEPT = 20
"""Number of reports of a moving robot remembered: those of some seconds."""


class RobotLag:
    """The greatest lag that was reported lately under the present strategy, of any goal: `seconds`, 0 for a robot that is ahead, since it may be so for
    a moment only. Read from any thread; messages come one at a time.
    """

    def __init__(self) -> None:
        self.seconds = 0.0
        self._reported: deque[float] = deque(maxlen=_REPORTS_KEPT)
        self._strategy: str | None = None

    def on_goal(self, goal: GoalState) -> None:
        """Take a goal's progress."""
        if goal.lag is not None:
            self._reported.append(goal.lag)
            self.seconds = max(*self._reported, 0.0)

    def on_state(self, state: ExecutorState) -> None:
        """Take the executor's strategy; another one drives the robot in another way."""
        if state.strategy != self._strategy:
            self._strategy = state.strategy
            self._reported.clear()
            self.seconds = 0.0
