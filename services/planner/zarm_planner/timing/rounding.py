"""Rounds a trajectory to as many decimals as its limits need: its message is half as long, and arrives sooner."""

from __future__ import annotations

import numpy as np

from zarm_planner.kernels.rounding import round_samples
from zarm_trajectory.limits import Limits
from zarm_trajectory.trajectory import TimedTrajectory

_SHARE = 2e-5
"""Share of the jerk limit by which each rounded quantity may change the jerk; less than verification tolerates."""
_LEAST = np.array((1e9, 1e7, 1e5))
"""Least decimals of positions, velocities and accelerations, as powers of ten."""
_JERK = np.array((120.0, 48.0, 18.0))
"""Jerk of a quintic over 1 s whose position, velocity or acceleration changes by 1 at both ends, in opposite directions: twice the
coefficients 60, 24 and 9 in its third derivative at an end.
"""


def rounded(trajectory: TimedTrajectory, limits: Limits) -> TimedTrajectory:
    """The trajectory with rounded positions, velocities and accelerations, within `_SHARE` of the jerk limit for each.

    A sample close in time to its neighbours keeps more decimals, and the two ends keep all.
    """
    units = 2 * _SHARE / _JERK[:, None] * limits.jerk
    time = trajectory.time
    states = round_samples(time, trajectory.position, trajectory.velocity, trajectory.acceleration, units, _LEAST)
    return TimedTrajectory(time, *states)
