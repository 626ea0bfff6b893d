"""How much later than its commands the robot moves, as the executor measures it."""

from __future__ import annotations

from collections import deque

from zarm_contract.messages import ExecutorState, GoalState

_REMEMBERED = 20
"""Number of reports of a moving robot remembered: those of some seconds."""


class RobotLag:
    """The greatest lag that was reported lately under the present strategy, of any goal."""

    def __init__(self) -> None:
        self._reported: deque[float] = deque(maxlen=_REMEMBERED)
        self._strategy: str | None = None

    @property
    def seconds(self) -> float:
        """The lag (s); 0 for a robot that is ahead, since it may be so for a moment only."""
        return max((*self._reported, 0.0))

    def on_goal(self, goal: GoalState) -> None:
        """Take a goal's progress."""
        if goal.lag is not None:
            self._reported.append(goal.lag)

    def on_state(self, state: ExecutorState) -> None:
        """Take the executor's strategy; another one drives the robot in another way."""
        if state.strategy != self._strategy:
            self._strategy = state.strategy
            self._reported.clear()
