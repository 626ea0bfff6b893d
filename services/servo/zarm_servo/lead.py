"""How far ahead on a running trajectory a new one takes over: as soon as it can be ready."""

from __future__ import annotations

from collections import deque

SHORTEST, LONGEST = 0.04, 0.4
"""Bounds of the lead (s)."""
_SPARE = 1.25
"""Factor on the longest of the recent times that gives the lead."""
_LATER = 1.5
"""A trajectory that came too late is assumed to have needed this many times the lead it was given."""
_REMEMBERED = 4
"""Number of recent times remembered."""


class Lead:
    """Learns from the time it takes to plan and hand over a trajectory."""

    def __init__(self) -> None:
        self._took: deque[float] = deque(maxlen=_REMEMBERED)

    @property
    def seconds(self) -> float:
        """The lead: how long (s) after the request a new trajectory takes over."""
        return min(max(_SPARE * max(self._took, default=0.0), SHORTEST), LONGEST)

    def in_time(self, took: float) -> None:
        """A trajectory was ready after this time (s)."""
        self._took.append(took)

    def too_late(self) -> None:
        """A trajectory was not ready in time."""
        self._took.append(_LATER * self.seconds)
