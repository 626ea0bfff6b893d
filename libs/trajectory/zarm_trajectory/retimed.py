"""A trajectory along another one at a different speed: what a driver is told to play."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from zarm_trajectory.arrays import Array
from zarm_trajectory.path_state import PathState
from zarm_trajectory.trajectory import TimedTrajectory


@dataclass(frozen=True)
class RetimedTrajectory:
    """N points along a planned trajectory, one every `dt` s.

    `points` is what is played, from time 0 on; `path_time` (N,) is the time (s) on the planned trajectory of each
    point, `path_speed` (N,) in [0, 1] the path speed there, and `path_rate` (N,) in 1/s its rate of change.
    """

    dt: float
    path_time: Array
    path_speed: Array
    path_rate: Array
    points: TimedTrajectory

    @classmethod
    def along(
        cls, trajectory: TimedTrajectory, dt: float, path_time: Array, path_speed: Array, path_rate: Array
    ) -> Self:
        """Points every `dt` s along `trajectory`; their acceleration is q'' sigma^2 + q' dsigma/dt (chain rule)."""
        position, slope, bend = trajectory.sample(path_time)
        speed, rate = path_speed[:, None], path_rate[:, None]
        points = position, slope * speed, bend * speed**2 + slope * rate
        return cls(
            dt, path_time, path_speed, path_rate, TimedTrajectory(np.arange(float(len(path_time))) * dt, *points)
        )

    def __len__(self) -> int:
        return len(self.path_time)

    @property
    def last(self) -> float:
        """The index of the last point."""
        return float(len(self) - 1)

    def followed_by(self, other: RetimedTrajectory) -> RetimedTrajectory:
        """These points, then those of `other`, whose first is at the last of these."""
        states = np.concatenate((self.points.states, other.points.states[:, 1:]), axis=1)
        return type(self)(
            self.dt,
            np.append(self.path_time, other.path_time[1:]),
            np.append(self.path_speed, other.path_speed[1:]),
            np.append(self.path_rate, other.path_rate[1:]),
            TimedTrajectory(np.arange(float(states.shape[1])) * self.dt, *states),
        )

    def at(self, index: float) -> PathState:
        """The path state at a point, or between two; beyond them that of the nearest end."""
        places = np.arange(float(len(self)))
        return PathState(
            *(float(np.interp(index, places, row)) for row in (self.path_time, self.path_speed, self.path_rate))
        )

    def position(self, index: float) -> Array:
        """The position (J,) at a point, or on the straight line between two; beyond them that of the nearest end."""
        index = min(max(index, 0.0), self.last)
        before = int(index)
        after, share = min(before + 1, len(self) - 1), index - before
        position = self.points.position
        return np.asarray(position[before] + share * (position[after] - position[before]))
