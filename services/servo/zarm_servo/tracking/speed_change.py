"""The fastest change from any velocity and acceleration to a constant velocity within acceleration and jerk limits."""

from __future__ import annotations

from typing import Self

import numpy as np

from zarm_servo.kernels.speed_change import phases, sampled
from zarm_trajectory.arrays import Array


class SpeedChange:
    """How J joints change from one velocity to another: the acceleration rises to a peak, is kept, and returns to zero.

    Each joint takes the time that it needs; `duration` (s) is that of the slowest. Afterwards the velocities are
    constant. A velocity never leaves the range of those successively requested: another one can always be requested
    during a change, inside the limits (a constant jerk to zero acceleration, with which the change starts, ends in that
    range).
    """

    def __init__(self, times: Array, states: Array, jerks: Array) -> None:
        self._times, self._states, self._jerks = times, states, jerks
        self.duration = float(times[-1].max())

    @property
    def knots(self) -> Array:
        """The times (K,) s from 0 to the end between which the jerk of every joint is constant."""
        return np.unique(self._times)

    @classmethod
    def to(cls, wanted: Array, state: Array, acceleration_limit: Array, jerk_limit: Array) -> Self:
        """To the velocities `wanted` (J,) in rad/s, from a state (3, J): position, velocity, acceleration. Limits (J,)
        in rad/s^2 and rad/s^3.

        With the jerk J and the peak p the velocity changes by (p^2 - a^2) / 2 J + p^2 / 2 J, plus the part while the
        peak is kept (Kroeger and Wahl, "Online trajectory generation", 2010, for a velocity as the target).
        """
        return cls(*phases(wanted, state, acceleration_limit, jerk_limit))

    def sample(self, times: Array) -> Array:
        """Positions, velocities and accelerations (3, K, J) at `times` (K,) from 0 on."""
        return sampled(self._times, self._states, self._jerks, times)

    def at(self, time: float) -> Array:
        """Position, velocity and acceleration (3, J) at a `time` (s) from 0 on."""
        return self.sample(np.array([time]))[:, 0].copy()
