"""Where the robot should be by now, given the delay between command and motion."""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from dataclasses import dataclass

import numpy as np

from zarm_trajectory.arrays import Array
from zarm_trajectory.follower import Follower

_SMALL = 1e-18
"""A square (rad²) that counts as 0."""


@dataclass(frozen=True, slots=True)
class Commanded:
    """The command at the moment `now`: path time (s), path speed, position (J,) rad."""

    now: float
    time: float
    speed: float
    position: Array


class Reference:
    """The commands of a follower over the last `memory` s, interpolated at any moment in between."""

    def __init__(self, memory: float) -> None:
        self._memory = memory
        self._past: deque[Commanded] = deque()

    def note(self, now: float, follower: Follower) -> None:
        """Note the follower's state at the moment `now`, which is later than the previous one."""
        speed = 0.0 if follower.at_rest else follower.speed
        self._past.append(Commanded(now, follower.time, speed, follower.position))
        while len(self._past) > 1 and self._past[1].now < now - self._memory:
            self._past.popleft()

    def nearest(self, position: Array, first: float, last: float) -> Array:
        """The position (J,) nearest to `position` (J,) on the way commanded from the moment `first` to `last`, to a tick."""
        commanded = np.array([one.position for one in self._past if first <= one.now <= last])
        if len(commanded) < 2:
            return self.at(last).position
        steps, away = np.diff(commanded, axis=0), position - commanded[:-1]
        squares = np.einsum("ij,ij->i", steps, steps)
        share = np.einsum("ij,ij->i", away, steps) / np.maximum(squares, _SMALL)
        away -= steps * np.minimum(np.maximum(share, 0.0), 1.0)[:, None]
        nearest: Array = position - away[np.einsum("ij,ij->i", away, away).argmin()]
        return nearest

    def at(self, moment: float) -> Commanded:
        """The command at that moment; outside the recorded time, the first or last one."""
        index = bisect_right(self._past, moment, key=lambda one: one.now)
        if index == 0:
            return self._past[0]
        if index == len(self._past):
            return self._past[-1]
        before, after = self._past[index - 1], self._past[index]
        share = (moment - before.now) / (after.now - before.now)
        return Commanded(
            moment,
            before.time + share * (after.time - before.time),
            before.speed + share * (after.speed - before.speed),
            before.position + share * (after.position - before.position),
        )
