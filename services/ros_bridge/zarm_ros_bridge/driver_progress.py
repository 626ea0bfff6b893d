"""What a driver's progress, one number from 0 to 1, says about the command that was sent to it last."""

from __future__ import annotations

from zarm_contract.messages import DriverProgress

_STEPS = 5
"""A driver that counts on is at most so many points further than when it was heard last."""


class ProgressReader:
    """Reads the share of points that a driver says it has played.

    The Doosan bridge counts on where a command replaces one that is still played: its number is then of all points since
    it last stood, by those of the first of these commands, and above 1 in the end. A driver that counts anew with every
    command is told from it by the jump that its number makes.
    """

    def __init__(self) -> None:
        self._sequence = 0
        self._points = 0
        self._base = 1  # what the driver divides by
        self._before = 0.0  # points of `_base` that it had played when the last command came
        self._told = 1.0

    def sent(self, sequence: int, points: int) -> None:
        """The command `sequence` of so many points goes to the driver; none: it is to stop."""
        self._sequence, self._points = sequence, points
        self._before = self._told * self._base
        if not self._told * self._base % self._base:
            self._anew()

    def read(self, told: float) -> DriverProgress | None:
        """How far the driver is with the last command; None where that was to stop, or nothing was sent."""
        if self._before and not 0.0 <= told - self._told <= _STEPS / self._base:
            self._anew()
        self._told = told
        if not self._points:
            return None
        played = told * self._base - self._before
        return DriverProgress(sequence=self._sequence, fraction=min(max(played / self._points, 0.0), 1.0))

    def _anew(self) -> None:
        self._base, self._before, self._told = max(self._points, 1), 0.0, 0.0
