"""The way to rest from any point of a trajectory, computed all at once: what every streamed chunk ends with.

As in `follower.py`, the acceleration of q(s(t)) is q''(s) sigma^2 + q'(s) dsigma/dt. Here each step of sigma is as long as a point of
the driver, and the trajectory is looked up on a fine grid.
"""

from __future__ import annotations

import numpy as np

from zarm_trajectory.quintic import Array
from zarm_trajectory.retimed import RetimedTrajectory
from zarm_trajectory.trajectory import TimedTrajectory

_FINENESS = 8
"""Samples of the trajectory for each point at full path speed."""
_SPAN = 0.5
"""So much (s) of the path is sampled at once."""
_SHARE = 0.99
"""Share of the acceleration limits that is used, as the trajectory bends between two samples of it."""
_LONGEST = 1000
"""Points after which a robot that is not at rest by then stops nevertheless; braking along a trajectory takes a tenth of that."""
_STANDING = 1e-9
"""Slope of a trajectory, rad/s, below which a joint says nothing about the path speed."""


def braking(trajectory: TimedTrajectory, time: float, speed: float, limit: Array, dt: float) -> RetimedTrajectory:
    """Points every `dt` s from path time `time` (s) with path speed `speed` to rest, as hard as the limits (J,) rad/s^2 allow.

    The last point is at rest. A trajectory that decelerates to its end at its limits is followed to its end.
    """
    table = _Table(trajectory, time, _SHARE * limit, dt / _FINENESS)
    times, speeds, rates = [time], [speed], []
    while speed > 0.0 and time < trajectory.duration and len(times) < _LONGEST:
        if not table.covers(time + speed * dt):
            table = _Table(trajectory, time, _SHARE * limit, dt / _FINENESS)
        rate = max(table.least(time, speed), -speed / dt)
        after = speed + rate * dt
        rate = max(
            rate, table.least(time + 0.5 * (speed + after) * dt, after)
        )  # the limits hold where the step ends, too
        after = speed + rate * dt
        time = min(time + 0.5 * (speed + after) * dt, trajectory.duration)
        speed = 0.0 if after < 1e-9 or time >= trajectory.duration else after
        times.append(time)
        speeds.append(speed)
        rates.append(rate)
    speeds[-1] = 0.0
    rates.append(0.0)
    sigma, rate_column = np.array(speeds)[:, None], np.array(rates)[:, None]
    position, slope, bend = trajectory.sample(np.array(times))
    return RetimedTrajectory.of(
        dt, np.array(times), np.array(speeds), position, slope * sigma, bend * sigma**2 + slope * rate_column
    )


class _Table:
    """The strongest braking on `_SPAN` s of a trajectory from `begin` on, sampled every `step` s."""

    def __init__(self, trajectory: TimedTrajectory, begin: float, limit: Array, step: float) -> None:
        self._begin, self._step = begin, step
        grid = np.arange(begin, begin + _SPAN + step, step)
        _, slope, bend = trajectory.sample(np.minimum(grid, trajectory.duration))
        moving = np.abs(slope) > _STANDING
        inverse = 1.0 / np.where(moving, np.abs(slope), 1.0)
        self._flat = np.where(moving, -limit * inverse, -np.inf)
        self._curved = np.where(moving, -np.sign(slope) * bend * inverse, 0.0)

    def covers(self, time: float) -> bool:
        """Whether this path time is on it."""
        return time <= self._begin + _SPAN

    def least(self, time: float, speed: float) -> float:
        """The least dsigma/dt, 1/s, at which no joint brakes harder than its limit; 0 where the trajectory alone needs all of it."""
        row = int((time - self._begin) / self._step)
        cell = slice(row, row + 2)  # the trajectory may bend otherwise between two samples of it
        return min(float((self._flat[cell] + self._curved[cell] * speed**2).max()), 0.0)
