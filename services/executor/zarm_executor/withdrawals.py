"""Goals that are cancelled before they start."""

from __future__ import annotations

from collections import deque

GOALS_KEPT = 4096
"""Number of goals remembered that were cancelled before they arrived."""


class Withdrawals:
    """The goals that will not start. `successor` is the goal that waits for the one it preempts."""

    def __init__(self) -> None:
        self._goal_ids: deque[str] = deque(maxlen=GOALS_KEPT)
        self.successor: str | None = None

    def withdraw(self, goal_id: str) -> None:
        """This goal will not start."""
        self._goal_ids.append(goal_id)

    def __contains__(self, goal_id: str) -> bool:
        return goal_id in self._goal_ids
