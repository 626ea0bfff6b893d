"""Rounds a trajectory to as many decimals as its limits need: its message is half as long, and arrives sooner."""

from __future__ import annotations

import numpy as np

from zarm_planner.kernels.rounding import round_samples
from zarm_trajectory.limits import Limits
from zarm_trajectory.trajectory import TimedTrajectory

_LIMIT_SHARE = 2e-5
"""Share of a limit by which each rounded quantity may change jerk and acceleration; less than verification tolerates."""
_LEAST_DECIMALS = np.array((1e9, 1e7, 1e5))
"""Least decimals of positions, velocities and accelerations, as powers of ten."""
_JERK = np.array((120.0, 48.0, 18.0))
"""Jerk of a quintic over 1 s whose position, velocity or acceleration changes by 1 at both ends, in opposite directions: twice the
coefficients 60, 24 and 9 in its third derivative at an end.
"""
_ACCELERATION = np.array((20 / 3**0.5, 3.0, 1.0))
"""The greatest acceleration of the same quintics."""


def rounded(trajectory: TimedTrajectory, limits: Limits) -> TimedTrajectory:
    """The trajectory with rounded positions, velocities and accelerations, within `_LIMIT_SHARE` of the jerk and acceleration limits
    for each.

    A sample close in time to its neighbours keeps more decimals, and the two ends keep all.
    """
    time = trajectory.time
    longest = float(np.diff(time).max())
    units = (
        2
        * _LIMIT_SHARE
        * np.minimum(limits.jerk / _JERK[:, None], limits.acceleration / (longest * _ACCELERATION[:, None]))
    )
    states = round_samples(
        time, trajectory.position, trajectory.velocity, trajectory.acceleration, units, _LEAST_DECIMALS
    )
    return TimedTrajectory(time, *states)
