"""The time of the control loop, and gaps in it."""

from __future__ import annotations

import math

_SUSPENSION = 3.5
"""A process suspended for longer than this (s) may have lost its link to the router, which drops a silent peer after 5
s. A cancel of an earlier request may then not have arrived.
"""
_BACKLOG_TIME = 0.5
"""For this long (s) after that, arriving requests may be old."""
EARLIEST = 0.08
"""How long (s) before its first command a motion may have begun: time that is caught up at once."""


class TickClock:
    """The ticks of a loop of this `period` (s). Times (s) are on the monotonic clock."""

    def __init__(self, period: float) -> None:
        self._period = period
        self._resumed_at = -math.inf
        self.now = -math.inf
        """The time of the latest tick."""
        self.missed = 0
        """The number of missed ticks."""
        self._begun: float | None = None

    def advance(self, now: float) -> float:
        """Register a tick at `now` and return the time (s) since the last tick or, if later, since the motion began; 0 for the first tick."""
        dt = 0.0 if math.isinf(self.now) else now - self.now
        self.now = now
        if dt > _SUSPENSION:
            self._resumed_at = now
        self.missed += max(0, round(dt / self._period) - 1)
        if self._begun is not None:
            dt, self._begun = max(now - self._begun, 0.0), None
        return dt

    def begin(self, at: float) -> None:
        """A motion begins at `at`, before the next tick: its time counts from then on."""
        if abs(at - self.now) < EARLIEST + self._period:
            self._begun = at

    def suspended(self, now: float) -> bool:
        """The loop stood still until just now, so that a request arriving at `now` may be old."""
        standing = not math.isinf(self.now) and now - self.now > _SUSPENSION
        return standing or now - self._resumed_at < _BACKLOG_TIME
