"""By how much a robot is behind its commands."""

from __future__ import annotations

from zarm_executor.strategies.base import Measured
from zarm_trajectory.arrays import Array
from zarm_trajectory.follower import CATCH_UP

_WINDOW = 0.3
"""Time constant (s) with which older ticks are forgotten."""
_SPEED = 0.05
"""At a lower speed (rad/s, root mean square over the window) there is no lag to see."""


class Lag:
    """The lag that explains best, by least squares over the last ticks, how far the joints are from their commands.

    A deviation `e` at the velocity `v` is a lag of e·v / v·v. A lag of T delays a jerk-free motion by (v + v') T / 2, with the velocities at
    both ends, so the mean of the commanded and the measured velocity is used.
    """

    def __init__(self) -> None:
        self._command: Array | None = None
        self._along = self._square = 0.0

    @property
    def seconds(self) -> float | None:
        """The lag (s), negative if the robot is ahead; None at rest."""
        return self._along / self._square if self._square > _SPEED**2 * _WINDOW else None

    def observe(self, now: float, dt: float, command: Array, measured: Measured | None) -> None:
        """Take the positions `command` (J,) meant for `now` (s, monotonic), `dt` s after those before, and the joints that are known then."""
        before, self._command = self._command, command
        if before is None or measured is None or not 0.0 < dt <= CATCH_UP:
            return
        commanded = (command - before) / dt
        velocity = 0.5 * (commanded + measured.velocity)
        behind = command - commanded * (now - measured.time) - measured.position
        kept = 1.0 - dt / _WINDOW
        self._along = kept * self._along + dt * float(behind @ velocity)
        self._square = kept * self._square + dt * float(velocity @ velocity)
