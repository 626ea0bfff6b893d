"""When the steps of a stream are commanded: an estimate of how far the executor is, from a state published about ten times a second,
and even times for steps that follow a chunk.
"""

from __future__ import annotations

import threading

from zarm_contract.messages import GoalState

_AGE, _OLDEST = 0.02, 0.12
"""Usual and greatest age (s) of a goal state when it arrives."""
_NEARER = 0.1
"""Share of the deviation corrected with each state, so that the clock recovers after the executor was delayed."""


_UNEVEN = 0.002
"""An estimate that is off by more than this (s) is believed at once; until then, steps are a period apart."""
_LEARNT = 0.03
"""Share of a measured lag that is made up for at once."""
_LARGEST_LAG = 0.05
"""No more (s) is made up for."""


class StepTimes:
    """The times for which steps are meant, without the jitter of the estimates."""

    def __init__(self) -> None:
        self._last, self._lag = float("-inf"), 0.0

    def learn(self, lag: float) -> None:
        """The robot was measured so long (s) behind the time that a step was meant for."""
        self._lag = min(max(self._lag + _LEARNT * lag, -_LARGEST_LAG), _LARGEST_LAG)

    def next(self, period: float, estimate: float) -> float:
        """The time (s) of the next step, which is a `period` (s) after the one before unless the `estimate` is far from it."""
        self._last += period
        if abs(self._last - estimate - self._lag) > _UNEVEN:
            self._last = estimate + self._lag
        return self._last


class StreamClock:
    """The stream's time, which runs as the robot moves. `now` is on the monotonic clock. Thread-safe.

    `delay` (s): how far the robot is expected, and reported, behind the command.
    """

    def __init__(self, delay: float) -> None:
        self._delay = delay
        self._scale, self._rate = 1.0, 0.0
        self._time, self._at = 0.0, 0.0
        self._lock = threading.Lock()

    @property
    def scale(self) -> float:
        """The robot's current speed as a share of the planned speed."""
        return self._scale

    def time(self, now: float) -> float:
        """The stream time (s) that is being commanded."""
        with self._lock:
            return self._time + self._rate * (now - self._at)

    def set_speed(self, scale: float, now: float) -> None:
        """From `now` on the robot moves at this share of the planned speed."""
        with self._lock:
            self._advance(now)
            self._scale = scale
            if self._rate > 0.0:
                self._rate = scale

    def receive(self, goal: GoalState, now: float) -> None:
        """Take a state of the stream from the executor."""
        with self._lock:
            self._advance(now)
            reported, behind = goal.progress * goal.duration, self._scale * self._delay
            self._rate = self._scale if goal.status == "running" and goal.hold is None else 0.0
            least = reported + self._rate * _AGE + (behind if reported > 0.0 else 0.0)
            time = min(max(self._time, least), reported + behind + _OLDEST)
            self._time = time - _NEARER * (time - least)

    def _advance(self, now: float) -> None:
        self._time += self._rate * (now - self._at)
        self._at = now
