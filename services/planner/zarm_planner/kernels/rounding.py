"""Rounding of the samples of a trajectory to decimals."""

from __future__ import annotations

import numpy as np

from zarm_geometry.kernels.compiled import brief, inlined
from zarm_trajectory.arrays import Array

MOST_DECIMALS = 15
"""Most decimals: beyond them a float has none."""


@inlined
def _decimal(value: float, unit: float, least: float) -> float:
    """The nearest multiple of the largest decimal unit up to `unit` and up to 1 / `least`."""
    scale = least
    while scale * unit < 1.0 and scale < 10.0**MOST_DECIMALS:
        scale *= 10.0
    return float(np.rint(value * scale) / scale)


@brief
def round_samples(
    time: Array, position: Array, velocity: Array, acceleration: Array, units: Array, least: Array
) -> tuple[Array, Array, Array]:
    """Position, velocity and acceleration (n, dof) at `time` (n,), rounded except at both ends.

    The largest decimal unit of each is `units` (3, dof), for samples 1 s apart, times the third, second and first power
    of the time (s) to the nearer neighbour; but at most 1 / `least` (3,).
    """
    rounded = position.copy(), velocity.copy(), acceleration.copy()
    for i in range(1, time.shape[0] - 1):
        h = min(time[i] - time[i - 1], time[i + 1] - time[i])
        for j in range(position.shape[1]):
            rounded[0][i, j] = _decimal(position[i, j], units[0, j] * h * h * h, least[0])
            rounded[1][i, j] = _decimal(velocity[i, j], units[1, j] * h * h, least[1])
            rounded[2][i, j] = _decimal(acceleration[i, j], units[2, j] * h, least[2])
    return rounded
