"""Estimates how far the executor has commanded a stream, from a state published some ten times a second."""

from __future__ import annotations

import threading

from zarm_contract.messages import GoalState

_AGE, _OLDEST = 0.02, 0.12
"""What a goal tells of itself is usually so old (s) when it is heard, and at most."""
_NEARER = 0.1
"""So much of the difference to what is told is taken back at every word: an executor that was held up is found again."""


class StreamClock:
    """The time of a stream, which runs as the robot moves. `now` is on the monotonic clock. Safe from any thread.

    `delay` (s): so far behind what is commanded a robot is expected, and told.
    """

    def __init__(self, delay: float) -> None:
        self._delay = delay
        self._scale, self._rate = 1.0, 0.0
        self._time, self._at = 0.0, 0.0
        self._lock = threading.Lock()

    @property
    def scale(self) -> float:
        """The share of the planned speed at which the robot moves."""
        return self._scale

    def time(self, now: float) -> float:
        """How far (s) the stream is commanded."""
        with self._lock:
            return self._time + self._rate * (now - self._at)

    def set_speed(self, scale: float, now: float) -> None:
        """The robot moves at this share of the planned speed from now on."""
        with self._lock:
            self._advance(now)
            self._scale = scale
            if self._rate > 0.0:
                self._rate = scale

    def hear(self, goal: GoalState, now: float) -> None:
        """What the executor tells of the stream."""
        with self._lock:
            self._advance(now)
            told, behind = goal.progress * goal.duration, self._scale * self._delay
            self._rate = self._scale if goal.status == "running" and goal.hold is None else 0.0
            least = told + self._rate * _AGE + (behind if told > 0.0 else 0.0)
            time = min(max(self._time, least), told + behind + _OLDEST)
            self._time = time - _NEARER * (time - least)

    def _advance(self, now: float) -> None:
        self._time += self._rate * (now - self._at)
        self._at = now
