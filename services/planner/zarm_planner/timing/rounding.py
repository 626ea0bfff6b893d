"""Rounds a trajectory to as many decimals as its limits need: its message is half as long, and arrives sooner."""

from __future__ import annotations

import numpy as np

from zarm_trajectory.limits import Limits
from zarm_trajectory.quintic import Array
from zarm_trajectory.trajectory import TimedTrajectory

_SHARE = 2e-5
"""Share of the jerk limit by which each rounded quantity may change the jerk; less than verification tolerates."""
_LEAST, _MOST = (9, 7, 5), 15
"""Least decimals of positions, velocities and accelerations, and most of any: beyond them a float has none."""
_JERK = 120.0, 48.0, 18.0
"""Jerk of a quintic over 1 s whose position, velocity or acceleration changes by 1 at both ends, in opposite directions: twice the
coefficients 60, 24 and 9 in its third derivative at an end.
"""


def rounded(trajectory: TimedTrajectory, limits: Limits) -> TimedTrajectory:
    """The trajectory with rounded positions, velocities and accelerations, within `_SHARE` of the jerk limit for each.

    A sample close in time to its neighbours keeps more decimals, and the two ends keep all.
    """
    gaps = np.diff(trajectory.time)
    shorter = np.minimum(np.append(gaps, np.inf), np.append(np.inf, gaps))[:, None]
    allowed = _SHARE * limits.jerk
    position, velocity, acceleration = (
        _rounded(values, 2 * allowed * shorter**power / jerk, least)
        for values, power, jerk, least in zip(trajectory.states, (3, 2, 1), _JERK, _LEAST, strict=True)
    )
    return TimedTrajectory(trajectory.time, position, velocity, acceleration)


def _rounded(values: Array, unit: Array, least: int) -> Array:
    """The values as multiples of a decimal unit no larger than `unit`, with at least so many decimals."""
    scale = 10.0 ** np.clip(np.ceil(-np.log10(unit)), least, _MOST)
    found = np.round(values * scale) / scale
    found[[0, -1]] = values[[0, -1]]
    return np.asarray(found)
