"""How far ahead on a running trajectory a new one takes over: as soon as it can be ready."""

from __future__ import annotations

from collections import deque

SHORTEST, LONGEST = 0.06, 0.4
"""Bounds of the lead (s)."""
_SPARE = 1.25
"""The lead is so many times the longest of the last times."""
_LATER = 2.0
"""After one that was too late the lead is so many times as long, until one is in time."""
_REMEMBERED = 8
"""So many times are remembered."""


class Lead:
    """Learns from how long it took to plan and hand over a trajectory."""

    def __init__(self) -> None:
        self._took: deque[float] = deque(maxlen=_REMEMBERED)
        self._longer = 1.0

    @property
    def seconds(self) -> float:
        """A new trajectory takes over so long (s) after it was asked for."""
        lead = max(_SPARE * max(self._took, default=0.0), SHORTEST)
        return min(lead * self._longer, LONGEST)

    def in_time(self, took: float) -> None:
        """A trajectory was there after so long (s)."""
        self._took.append(took)
        self._longer = 1.0

    def too_late(self) -> None:
        """A trajectory was not there in time."""
        self._longer = min(self._longer * _LATER, LONGEST / SHORTEST)
