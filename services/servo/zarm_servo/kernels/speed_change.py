"""The phases of constant jerk in which joints change their speed, and the states on the way."""

from __future__ import annotations

import math

import numpy as np

from zarm_geometry.kernels.compiled import brief, inlined
from zarm_trajectory.arrays import Array


@inlined
def _after(
    position: float, velocity: float, acceleration: float, jerk: float, time: float
) -> tuple[float, float, float]:
    """The state after some time at a constant jerk."""
    return (
        position + time * (velocity + time * (acceleration / 2 + time * jerk / 6)),
        velocity + time * (acceleration + time * jerk / 2),
        acceleration + time * jerk,
    )


@brief
def phases(wanted: Array, state: Array, acceleration_limit: Array, jerk_limit: Array) -> tuple[Array, Array, Array]:
    """The fastest change to the velocities `wanted` (J,) from a state (3, J), see `SpeedChange.to`.

    Returns when each of four phases begins (4, J), the states there (3, 4, J) and the jerks (4, J). The last phase has
    no jerk and no end.
    """
    joints = len(wanted)
    times, states, jerks = np.zeros((4, joints)), np.empty((3, 4, joints)), np.zeros((4, joints))
    for j in range(joints):
        v, a, limit, jerk = state[1, j], state[2, j], acceleration_limit[j], jerk_limit[j]
        straight = v + a * abs(a) / (2 * jerk)  # the velocity if the acceleration goes to 0 at once
        sign = 1.0 if wanted[j] >= straight else -1.0
        height = math.sqrt(max(sign * jerk * (wanted[j] - v) + a * a / 2, 0.0))
        peak = sign * min(height, limit)
        rise, fall = max(sign * (peak - a), 0.0) / jerk, abs(peak) / jerk
        level = 0.0
        if height > limit:
            level = max((wanted[j] - v - (a + peak) / 2 * rise - peak / 2 * fall) / peak, 0.0)
        jerks[0, j], jerks[2, j] = sign * jerk, -sign * jerk
        states[0, 0, j], states[1, 0, j], states[2, 0, j] = state[0, j], v, a
        for k, span in enumerate((rise, level, fall)):
            times[k + 1, j] = times[k, j] + span
            states[0, k + 1, j], states[1, k + 1, j], states[2, k + 1, j] = _after(
                states[0, k, j], states[1, k, j], states[2, k, j], jerks[k, j], span
            )
        states[1, 3, j], states[2, 3, j] = wanted[j], 0.0
    return times, states, jerks


@brief
def sampled(times: Array, states: Array, jerks: Array, at: Array) -> Array:
    """The states (3, K, J) of a change with these `phases` at the times `at` (K,) s."""
    joints = times.shape[1]
    found = np.empty((3, len(at), joints))
    for i in range(len(at)):
        for j in range(joints):
            k = 0
            while k < 3 and at[i] >= times[k + 1, j]:
                k += 1
            found[0, i, j], found[1, i, j], found[2, i, j] = _after(
                states[0, k, j], states[1, k, j], states[2, k, j], jerks[k, j], at[i] - times[k, j]
            )
    return found
