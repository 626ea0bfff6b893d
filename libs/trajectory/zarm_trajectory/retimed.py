"""The part of a motion that lies ahead, as the points that a driver plays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from zarm_trajectory.quintic import Array


@dataclass(frozen=True)
class RetimedTrajectory:
    """N points of a motion of J joints, one every `dt` s.

    `time` (N,) is the path time in s and `speed` (N,) the path speed in [0, 1] of each point; `position`, `velocity`,
    `acceleration` (N, J) in rad, rad/s, rad/s^2.
    """

    dt: float
    time: Array
    speed: Array
    position: Array
    velocity: Array
    acceleration: Array

    @property
    def last(self) -> float:
        """The index of the last point."""
        return float(len(self.time) - 1)

    def followed_by(self, other: RetimedTrajectory) -> RetimedTrajectory:
        """These points, then those of `other`, whose first is the last of these."""
        mine, others = ((one.time, one.speed, one.position, one.velocity, one.acceleration) for one in (self, other))
        return RetimedTrajectory(self.dt, *(np.concatenate((a, b[1:])) for a, b in zip(mine, others, strict=True)))

    def at(self, index: float) -> tuple[float, float, Array]:
        """TimedTrajectory time, path speed and position (J,) at a point, or between two; the nearest end beyond them."""
        index = min(max(index, 0.0), self.last)
        before = int(index)
        after, share = min(before + 1, len(self.time) - 1), index - before
        return (
            float(self.time[before] + share * (self.time[after] - self.time[before])),
            float(self.speed[before] + share * (self.speed[after] - self.speed[before])),
            np.asarray(self.position[before] + share * (self.position[after] - self.position[before])),
        )
