"""A trajectory that runs along another one at a speed of its own: what a driver is told to play."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from zarm_trajectory.quintic import Array
from zarm_trajectory.trajectory import TimedTrajectory


@dataclass(frozen=True)
class RetimedTrajectory:
    """N points along a planned trajectory, one every `dt` s.

    `points` is what is played, from time 0 on; `path_time` (N,) is the time (s) on the planned trajectory at which each point
    lies, and `path_speed` (N,) in [0, 1] how fast it is passed there.
    """

    dt: float
    path_time: Array
    path_speed: Array
    points: TimedTrajectory

    @classmethod
    def of(cls, dt: float, path_time: Array, path_speed: Array, *states: Array) -> Self:
        """From positions, velocities and accelerations, each (N, J), of points every `dt` s."""
        return cls(dt, path_time, path_speed, TimedTrajectory(np.arange(float(len(path_time))) * dt, *states))

    def __len__(self) -> int:
        return len(self.path_time)

    @property
    def last(self) -> float:
        """The index of the last point."""
        return float(len(self) - 1)

    def followed_by(self, other: RetimedTrajectory) -> RetimedTrajectory:
        """These points, then those of `other`, whose first is the last of these."""
        mine, others = ((one.path_time, one.path_speed, *one.points.states) for one in (self, other))
        return RetimedTrajectory.of(self.dt, *(np.concatenate((a, b[1:])) for a, b in zip(mine, others, strict=True)))

    def at(self, index: float) -> tuple[float, float, Array]:
        """Path time, path speed and position (J,) at a point, or between two; the nearest end beyond them."""
        index = min(max(index, 0.0), self.last)
        before = int(index)
        after, share = min(before + 1, len(self) - 1), index - before
        return (
            float(self.path_time[before] + share * (self.path_time[after] - self.path_time[before])),
            float(self.path_speed[before] + share * (self.path_speed[after] - self.path_speed[before])),
            np.asarray(
                self.points.position[before] + share * (self.points.position[after] - self.points.position[before])
            ),
        )
