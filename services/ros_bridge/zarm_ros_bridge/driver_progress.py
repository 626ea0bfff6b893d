"""Maps a driver's progress, a number from 0 to 1, to the command last sent to it."""

from __future__ import annotations

from zarm_contract.messages import DriverProgress

_WHOLE = 1e-3
"""A number of points is whole within this: progress comes in single precision, and shares of 1,000 points differ by as much."""


class ProgressReader:
    """Reads the share of points that a driver says it has played.

    Most drivers count anew with every command. The Doosan bridge counts on where a command replaces one that is still
    played: its number is then of all points since it last stood, by those of the first of these commands, and above 1 in the
    end. Which of the two a driver does shows, because it plays whole points; until it does, what is reported is the less.
    """

    def __init__(self) -> None:
        self._sequence = 0
        self._points = 0
        self._told = 0.0
        self._base = 0  # what a driver that counts on divides by; 0 where this one does not, or stood
        self._counts_on = False  # whether that has shown since it stood
        self._before = 0.0  # points that such a one had counted when the last command came

    def sent(self, sequence: int, points: int) -> None:
        """The command `sequence` of so many points goes to the driver; none: it is to stop."""
        base = self._base or self._points
        end = (self._before if self._base else 0.0) + self._points  # what it has counted when it has played all
        self._before = self._told * base
        self._base = base if 0.5 < self._before < end - 0.5 else 0
        self._sequence, self._points = sequence, points
        if not self._base:
            self._told, self._counts_on = 0.0, False

    def read(self, told: float) -> DriverProgress | None:
        """How far the driver is with the last command; None if that was to stop, or nothing was sent."""
        if self._base and (told <= self._told or abs(told * self._base - round(told * self._base)) > _WHOLE):
            self._base, self._counts_on = 0, False  # it counts anew
        self._told = told
        if not self._points:
            return None
        played = told * self._points
        if self._base:
            on = told * self._base - self._before
            self._counts_on = self._counts_on or abs(played - round(played)) > _WHOLE or played > self._points
            played = on if self._counts_on else min(on, played)
        return DriverProgress(sequence=self._sequence, fraction=min(max(played / self._points, 0.0), 1.0))
