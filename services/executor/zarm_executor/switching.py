"""The strategy that moves the robot, and the change to another one."""

from __future__ import annotations

from zarm_contract.errors import Unavailable, ZarmError
from zarm_executor.strategies.base import Strategy


class ActiveStrategy:
    """Holds one strategy, opened here, which may raise its ZarmError. One call at a time."""

    def __init__(self, strategy: Strategy) -> None:
        strategy.open()
        self.strategy = strategy
        self.is_open = True

    def open(self) -> None:
        """Open the strategy, unless it is open. Raises its ZarmError."""
        if not self.is_open:
            self.strategy.open()
            self.is_open = True

    def close(self) -> None:
        """Close the strategy, if it is open."""
        if self.is_open:
            self.strategy.close()
            self.is_open = False

    def switch(self, strategy: Strategy) -> None:
        """Close the active strategy, and open this one instead; the robot is at rest.

        Raises Unavailable if it cannot be opened. The old one is then open again, unless that fails too.
        """
        self.close()
        try:
            strategy.open()
        except ZarmError as error:
            raise self._reopened(f"{strategy.name} cannot start: {error}") from error
        self.strategy, self.is_open = strategy, True

    def _reopened(self, reason: str) -> Unavailable:
        """Open the old strategy again after a failed switch; returns the error to answer with."""
        try:
            self.open()
        except ZarmError as error:
            return Unavailable(
                f"{reason}; and {self.strategy.name} cannot start again: {error}; fix that, or switch to another strategy, "
                "then reset (executor/reset)"
            )
        return Unavailable(f"{reason}; {self.strategy.name} is active again")
