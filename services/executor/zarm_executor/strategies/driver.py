"""The common part of all strategies that move a robot through its driver."""

from __future__ import annotations

from zarm_contract.errors import Unavailable
from zarm_executor.strategies.base import Measured, Strategy
from zarm_executor.strategies.robot_link import RobotLink

HOLD_PERIOD = 0.1
"""A stopped robot is told to stop again at this interval (s) until it stands."""


class DriverStrategy(Strategy):
    """Reads the robot through a link. It opens only if the robot's driver reports the robot's joints, and stops the robot
    first.
    """

    def __init__(self, link: RobotLink) -> None:
        self.link = link
        self._held_at = 0.0
        self._emptied = False
        self._seen: Measured | None = None

    def look(self) -> None:
        """At the start of each tick: read the robot's state.

        Joints that arrive during a tick are for the next one, so that command and measurement belong to the same
        moment.
        """
        self._seen = self.link.measured()

    def hold(self, now: float) -> None:
        """At each tick after braking: empty the driver, and again while the robot moves.

        The driver may have missed the stop, as when a link was cut, or may still have points to play.
        """
        if self.link.standing() and self._emptied:
            return
        if now - self._held_at >= HOLD_PERIOD:
            self._held_at = now
            self._emptied = self.link.standing()
            self.link.stop()

    def sent(self, now: float) -> None:
        """Something to play was sent, so the driver is not empty."""
        self._held_at, self._emptied = now, False

    def pace(self) -> float:
        """As the driver reports it."""
        return self.link.pace()

    def obstacle(self) -> str | None:
        """No driver, or a silent one."""
        return self.link.obstacle()

    def open(self) -> None:
        """Make the driver drop whatever others left it to play."""
        reason = self.obstacle()
        if reason is not None:
            raise Unavailable(reason)
        self.look()
        self.link.stop()

    def close(self) -> None:
        """The robot is at rest; its driver has nothing left to play, and keeps reporting the joints."""
        self.link.stop()

    def admit(self) -> None:
        """Nothing to check: fresh joints are checked before every motion, whatever the strategy."""

    def joint_state(self) -> Measured | None:
        """The driver's report as of the last tick."""
        return self._seen
