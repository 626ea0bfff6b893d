"""The reason of a refusal, published long enough for occasional readers to see it."""

from __future__ import annotations

from zarm_contract.errors import Problem

SHOWN = 1.0
"""A refusal is published for at least this long (s), even if the next message was accepted."""


class Refusal:
    """The latest refusal, `problem`; None if there is none any more. `now` is in s, monotonic."""

    def __init__(self) -> None:
        self.problem: Problem | None = None
        self._since = 0.0

    def refused(self, problem: Problem, now: float) -> None:
        """Something was refused for this reason."""
        self.problem, self._since = problem, now

    def taken(self, now: float) -> None:
        """Something was accepted."""
        if now - self._since > SHOWN:
            self.problem = None
