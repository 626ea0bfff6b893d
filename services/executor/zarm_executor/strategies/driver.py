"""The common part of all strategies that move a robot through its driver."""

from __future__ import annotations

from zarm_contract.errors import Unavailable
from zarm_executor.strategies.base import Measured, Strategy
from zarm_executor.strategies.driver_link import DriverLink

HOLD_PERIOD = 0.1
"""A robot that was stopped is told so again this often (s) until it stands."""


class DriverStrategy(Strategy):
    """Reads the robot through a link. It opens only where the driver tells the robot's joints, and stops it first."""

    def __init__(self, link: DriverLink) -> None:
        self.link = link
        self._held_at = 0.0
        self._emptied = False
        self._seen: Measured | None = None

    def look(self) -> None:
        """At the begin of each tick: see where the robot is.

        Joints that come during a tick are for the next one: what is commanded and what is measured must be of one moment.
        """
        self._seen = self.link.measured()

    def hold(self, now: float) -> None:
        """After braking, at each tick: empty the driver, and again while the robot moves.

        It may not have heard of the stop, as while a link was cut, or still have points that it has not come to.
        """
        if self.link.standing() and self._emptied:
            return
        if now - self._held_at >= HOLD_PERIOD:
            self._held_at = now
            self._emptied = self.link.standing()
            self.link.stop()

    def sent(self, now: float) -> None:
        """Something to play was sent: the driver is not empty."""
        self._held_at, self._emptied = now, False

    def obstacle(self) -> str | None:
        """No driver, or one that is silent."""
        return self.link.obstacle()

    def open(self) -> None:
        """Have the driver drop whatever somebody else left it to play."""
        reason = self.obstacle()
        if reason is not None:
            raise Unavailable(reason)
        self.look()
        self.link.stop()

    def close(self) -> None:
        """The robot rests; its driver is left with nothing to play, and goes on telling where the robot is."""
        self.link.stop()

    def admit(self) -> None:
        """Whether the joints are fresh is checked before every motion, whatever the strategy."""

    def joint_state(self) -> Measured | None:
        """What the driver had told at the last tick."""
        return self._seen
