"""Jerk of a trajectory between its samples, as a second opinion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BPoly

from zarm_trajectory.trajectory import TimedTrajectory

LOOKS = 33
"""Sample times between two samples of the trajectory, including both."""


def greatest_jerk(trajectory: TimedTrajectory) -> NDArray[np.float64]:
    """The greatest jerk (J,) in rad/s^3 of the quintics that the contract prescribes, as SciPy interpolates.

    Each piece is evaluated separately: over such a short time SciPy's absolute times would cost precision.
    """
    steps = np.diff(trajectory.time)
    states = np.stack((trajectory.position, trajectory.velocity, trajectory.acceleration), axis=1)
    greatest = np.zeros(trajectory.position.shape[1])
    for i, step in enumerate(steps):
        begin, end = states[i].copy(), states[i + 1].copy()
        end[0] -= begin[0]
        begin[0] = 0.0
        scale = step ** np.arange(3.0)[:, None]
        piece = BPoly.from_derivatives([0.0, 1.0], [begin * scale, end * scale])
        jerk = np.abs(piece(np.linspace(0.0, 1.0, LOOKS), nu=3)).max(axis=0) / step**3
        greatest = np.maximum(greatest, jerk)
    return greatest
