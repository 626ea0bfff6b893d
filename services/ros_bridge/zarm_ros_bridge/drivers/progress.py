"""Maps a driver's progress, a number from 0 to 1, to the command last sent to it."""

from __future__ import annotations

from zarm_contract.messages import DriverProgress

_WHOLE = 1e-3
"""Tolerance for a whole number of points: progress comes in single precision, and shares of 1,000 points differ by as
much.
"""


class ProgressReader:
    """Reads the share of points that a driver reports as played.

    Most drivers restart the count with every command. The Doosan bridge keeps counting when a command replaces one that
    is still being played: it then divides all points since it last stood by those of the first of these commands, which
    ends above 1. Which of the two applies becomes clear, because drivers play whole points; until then, the smaller
    value is reported.
    """

    def __init__(self) -> None:
        self._sequence = 0
        self._points = 0
        self._reported = 0.0
        self._base = 0  # divisor of a driver that keeps counting; 0 if this one does not, or stood
        self._counts_on = False  # whether that is certain since it last stood
        self._before = 0.0  # points it had counted when the last command came

    def sent(self, sequence: int, points: int) -> None:
        """The command `sequence` with this number of points goes to the driver; 0 points: a stop."""
        base = self._base or self._points
        end = (self._before if self._base else 0.0) + self._points  # its count when all is played
        self._before = self._reported * base
        self._base = base if 0.5 < self._before < end - 0.5 else 0
        self._sequence, self._points = sequence, points
        if not self._base:
            self._reported, self._counts_on = 0.0, False

    def read(self, reported: float) -> DriverProgress | None:
        """Progress of the driver in the last command; None if that was a stop, or nothing was sent."""
        if self._base and (
            reported <= self._reported or abs(reported * self._base - round(reported * self._base)) > _WHOLE
        ):
            self._base, self._counts_on = 0, False  # it restarts the count
        self._reported = reported
        if not self._points:
            return None
        played = reported * self._points
        if self._base:
            on = reported * self._base - self._before
            self._counts_on = self._counts_on or abs(played - round(played)) > _WHOLE or played > self._points
            played = on if self._counts_on else min(on, played)
        return DriverProgress(sequence=self._sequence, fraction=min(max(played / self._points, 0.0), 1.0))
