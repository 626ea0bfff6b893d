"""The fastest change from any velocity and acceleration to a constant velocity within acceleration and jerk limits."""

from __future__ import annotations

from typing import Self

import numpy as np

from zarm_trajectory.quintic import Array


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
        position, velocity, acceleration = state
        straight = velocity + acceleration * np.abs(acceleration) / (2 * jerk_limit)  # if a goes to 0 at once
        sign = np.where(wanted >= straight, 1.0, -1.0)
        height = np.sqrt(np.maximum(sign * jerk_limit * (wanted - velocity) + acceleration**2 / 2, 0.0))
        peak = sign * np.minimum(height, acceleration_limit)
        rise, fall = np.maximum(sign * (peak - acceleration), 0.0) / jerk_limit, np.abs(peak) / jerk_limit
        missing = wanted - velocity - (acceleration + peak) / 2 * rise - peak / 2 * fall
        level = np.where(height > acceleration_limit, missing / np.where(peak == 0.0, 1.0, peak), 0.0)
        jerks = np.array((sign * jerk_limit, np.zeros_like(sign), -sign * jerk_limit, np.zeros_like(sign)))
        level = np.maximum(level, 0.0)
        states = np.empty((3, 4, len(position)))
        states[:, 0] = position, velocity, acceleration
        for k, span in enumerate((rise, level, fall)):
            states[:, k + 1] = _after(states[:, k], jerks[k], span)
        states[1, 3], states[2, 3] = wanted, 0.0
        return cls(np.cumsum((np.zeros_like(rise), rise, level, fall), axis=0), states, jerks)

    def sample(self, times: Array) -> Array:
        """Positions, velocities and accelerations (3, K, J) at `times` (K,) from 0 on."""
        phase = (np.asarray(times)[:, None, None] >= self._times[1:]).sum(axis=1)
        joint = np.arange(self._times.shape[1])
        since = np.asarray(times)[:, None] - self._times[phase, joint]
        return np.array(_after(self._states[:, phase, joint], self._jerks[phase, joint], since))


def _after(state: Array, jerk: Array, time: Array) -> tuple[Array, Array, Array]:
    """The state (3, ...) after some time at a constant jerk."""
    position, velocity, acceleration = state
    return (
        position + time * (velocity + time * (acceleration / 2 + time * jerk / 6)),
        velocity + time * (acceleration + time * jerk / 2),
        acceleration + time * jerk,
    )
