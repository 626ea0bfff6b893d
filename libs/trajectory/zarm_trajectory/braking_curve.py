"""How fast a robot may go along a trajectory so that it still comes to rest before a point of it: a train's braking curve.

As in `follower.py`, the acceleration of q(s(t)) is q''(s) sigma^2 + q'(s) dsigma/dt. With x = sigma^2 the strongest braking is
dx/ds = 2 dsigma/dt, which is integrated backwards from rest at the point (Bobrow, Dubowsky and Gibson 1985).
"""

from __future__ import annotations

import numpy as np

from zarm_trajectory.quintic import Array
from zarm_trajectory.trajectory import TimedTrajectory

_STEP = 0.005
"""Path time (s) from one point of the curve to the next."""
_SPAN = 100
"""So many points of the trajectory are looked up at once."""
_SHARE = 0.98
"""Share of the acceleration limits that the curve uses, as braking in ticks takes longer than along the curve."""
_FULL = 0.999
"""Squared path speed from which on the curve is at full speed."""
_STANDING = 1e-9
"""Slope of a trajectory, rad/s, below which a joint says nothing about the path speed."""


class BrakingCurve:
    """The path speed at which a robot with acceleration limits (J,) rad/s^2 may pass each path time, to rest at `end` (s)."""

    def __init__(self, trajectory: TimedTrajectory, end: float, limit: Array) -> None:
        self.end = end
        squares = [0.0]
        begin = end
        while begin > trajectory.time[0] and squares[-1] < _FULL:
            for flat, curved in zip(*_braking(trajectory, begin, _SHARE * limit), strict=True):
                square = squares[-1]
                rate = max(f + c * square for f, c in zip(flat, curved, strict=True))
                squares.append(square - 2 * _STEP * min(max(rate, -1.0 / _STEP), 0.0))
                if squares[-1] >= _FULL:
                    break
            begin = end - _STEP * (len(squares) - 1)
        self._squares = squares

    def speed(self, time: float) -> float:
        """The greatest path speed, 0 to 1, at the path time `time` (s)."""
        steps = (self.end - time) / _STEP
        if steps <= 0.0:
            return 0.0
        index = int(steps)
        if index + 1 >= len(self._squares):
            return 1.0
        before, after = self._squares[index], self._squares[index + 1]
        return float(min(before + (steps - index) * (after - before), 1.0) ** 0.5)


def _braking(trajectory: TimedTrajectory, end: float, limit: Array) -> tuple[list[list[float]], list[list[float]]]:
    """`flat` and `curved`, each a row of both ends' joints for each of `_SPAN` steps backwards from `end`: the strongest braking at
    a squared path speed x is the greatest of flat + curved x."""
    times = (end - _STEP * np.arange(_SPAN + 1)).clip(trajectory.time[0], trajectory.duration)
    _, slope, bend = trajectory.sample(times)
    moving = np.abs(slope) > _STANDING
    inverse = 1.0 / np.where(moving, np.abs(slope), 1.0)
    flat = np.where(moving, -limit * inverse, -np.inf)
    curved = np.where(moving, -np.sign(slope) * bend * inverse, 0.0)
    # The trajectory may bend otherwise between two samples of it.
    return (np.hstack((flat[:-1], flat[1:])).tolist(), np.hstack((curved[:-1], curved[1:])).tolist())
