"""How far ahead on a running trajectory a new one takes over: as soon as it is likely to be ready."""

from __future__ import annotations

from collections import deque

SHORTEST, LONGEST = 0.05, 0.4
"""Bounds of the lead (s)."""
_SPARE = 1.25
"""Factor on the second longest of the recent times that gives the lead: one slow plan does not delay the next takeovers."""
_LATER = 1.5
"""Factor by which the lead grows each time that a trajectory came too late, until one is in time."""
_TIMES_KEPT = 4
"""Number of recent times remembered."""


class Lead:
    """Learns from the time it takes to plan and hand over a trajectory."""

    def __init__(self) -> None:
        self._took: deque[float] = deque((0.0, 0.0), maxlen=_TIMES_KEPT)
        self._late = 0

    @property
    def seconds(self) -> float:
        """The lead: how long (s) after the request a new trajectory takes over."""
        likely = max(_SPARE * sorted(self._took)[-2], SHORTEST)
        return min(likely * _LATER**self._late, LONGEST)

    def in_time(self, took: float) -> None:
        """A trajectory was ready after this time (s)."""
        self._took.append(took)
        self._late = 0

    def too_late(self) -> None:
        """A trajectory was not ready in time."""
        if self.seconds < LONGEST:
            self._late += 1
