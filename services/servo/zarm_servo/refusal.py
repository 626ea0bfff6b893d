"""The reason of a refusal, published long enough for occasional readers to see it."""

from __future__ import annotations

from zarm_contract.errors import Problem

SHOWN = 1.0
"""A refusal is told for so long (s) at least, though what came after it was taken."""


class Refusal:
    """The last one, `problem`; None if there is none any more. Moments `now` are in s, monotonic."""

    def __init__(self) -> None:
        self.problem: Problem | None = None
        self._since = 0.0

    def refused(self, problem: Problem, now: float) -> None:
        """Something was refused with this."""
        self.problem, self._since = problem, now

    def taken(self, now: float) -> None:
        """Something was taken."""
        if now - self._since > SHOWN:
            self.problem = None
