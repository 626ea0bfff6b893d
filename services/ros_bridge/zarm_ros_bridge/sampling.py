"""A planned motion at equal steps in time."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from zarm_contract.messages import Trajectory

Array = npt.NDArray[np.float64]


def sampled(trajectory: Trajectory, dt: float) -> tuple[Array, Array]:
    """Positions and velocities (n, joints) at 0, dt, 2 dt, ... s, up to the first that is not before the end.

    Between its samples a trajectory is the quintic that meets position, velocity and acceleration at both (Hermite
    interpolation), as `Trajectory` defines it. It ends at rest, so what lies after its end is its end.
    """
    time = np.array(trajectory.time)
    position, velocity, acceleration = (
        np.array(rows) for rows in (trajectory.position, trajectory.velocity, trajectory.acceleration)
    )
    count = math.ceil(trajectory.duration / dt - 1e-9) + 1
    at = np.minimum(np.arange(count) * dt, trajectory.duration)
    i = np.clip(np.searchsorted(time, at, side="right") - 1, 0, len(time) - 2)
    h = (time[i + 1] - time[i])[:, None]
    u = (at - time[i])[:, None] / h
    p0, v0, a0 = position[i], velocity[i] * h, acceleration[i] * h * h
    p1, v1, a1 = position[i + 1], velocity[i + 1] * h, acceleration[i + 1] * h * h
    c3 = 10 * (p1 - p0) - 6 * v0 - 4 * v1 - 1.5 * a0 + 0.5 * a1
    c4 = -15 * (p1 - p0) + 8 * v0 + 7 * v1 + 1.5 * a0 - a1
    c5 = 6 * (p1 - p0) - 3 * (v0 + v1) - 0.5 * (a0 - a1)
    positions = p0 + u * (v0 + u * (a0 / 2 + u * (c3 + u * (c4 + u * c5))))
    velocities = (v0 + u * (a0 + u * (3 * c3 + u * (4 * c4 + u * 5 * c5)))) / h
    return positions, velocities
