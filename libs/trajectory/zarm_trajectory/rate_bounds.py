"""How fast the path speed may change along a trajectory, so that the joints' limits of acceleration and jerk hold.

The commanded motion is q(s(t)) with path time s, path speed sigma = ds/dt, its rate a = dsigma/dt and u = da/dt. By the chain rule

    acceleration  q'' sigma^2 + q' a
    jerk          q''' sigma^3 + 3 q'' sigma a + q' u

(Bobrow, Dubowsky and Gibson 1985; Tarkiainen and Shiller 1993). Both are linear in a and u, so at one point of the trajectory and one path
speed the limits of all joints are an interval of a, and one of u for each a. Zero is in both: a trajectory inside the limits is inside them
at every constant path speed below 1.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from zarm_trajectory.quintic import Array
from zarm_trajectory.trajectory import TimedTrajectory

ROW = 0.01
"""Path time, s, over which the bounds are one."""
_SPAN = 50
"""So many rows are looked up at once."""
_SAMPLES = 8
"""The trajectory is looked at so often in each row."""
_NODES = 8
"""Between so many squared path speeds from 0 to 1 the bounds are interpolated. They are concave in them, so that is conservative."""
_SLACK = 0.003
"""Share of a limit that a change of path speed may use where the trajectory alone needs all of it: less than anybody can measure."""
_STANDING = 1e-9
"""Slope of a trajectory, rad/s, below which a joint says nothing about the path speed."""
_MOST_RATE, _MOST_CHANGE = 1e3, 1e6
"""Bounds of a (1/s^2... of the path speed per s) and u where no joint says anything."""


class Bounds(NamedTuple):
    """For one direction of change: the greatest rate, how fast the rate may grow from 0 and at its greatest, and how fast it may fall again."""

    rate: float
    grow: float
    grow_at_rate: float
    shrink: float
    shrink_at_rate: float

    def rate_after(self, rate: float, dt: float) -> float:
        """The greatest rate that one of `rate` may have become `dt` s later."""
        return min(rate + _between(self.grow, self.grow_at_rate, rate, self.rate) * dt, self.rate)

    def shrink_from(self, rate: float) -> float:
        """How fast this rate may fall."""
        return _between(self.shrink, self.shrink_at_rate, rate, self.rate)


class RateBounds:
    """The bounds along `trajectory` for joints with these limits (J,) of acceleration (rad/s^2) and jerk (rad/s^3).

    What the trajectory itself has beyond a limit is granted to it; a change of path speed adds no more than the limit to a jerk that
    is beyond it already.
    """

    def __init__(self, trajectory: TimedTrajectory, acceleration: Array, jerk: Array) -> None:
        self._trajectory, self._acceleration, self._jerk = trajectory, acceleration, jerk
        self._tables: dict[int, tuple[list[list[list[float]]], list[list[list[float]]]]] = {}

    def at(self, row: int, speed: float, direction: int) -> Bounds:
        """The bounds in a row, the one that begins at the path time `row` x ROW (s), for slowing down (-1) or speeding up (1)."""
        block, index = divmod(row, _SPAN)
        table = self._tables.get(block)
        if table is None:
            table = self._tables[block] = self._look_up(block * _SPAN)
        node = speed * speed * _NODES
        low = min(int(node), _NODES - 1)
        share = node - low
        cells = table[direction > 0][index]
        return Bounds(*[a + share * (b - a) for a, b in zip(cells[low], cells[low + 1], strict=True)])

    def _look_up(self, first: int) -> tuple[list[list[list[float]]], list[list[list[float]]]]:
        trajectory = self._trajectory
        times = ROW * (first + np.arange(_SPAN * _SAMPLES + 1) / _SAMPLES)
        times = times.clip(trajectory.begin, trajectory.duration)
        row = np.arange(_SPAN)[:, None] * _SAMPLES + np.arange(_SAMPLES + 1)
        states = [each[row][..., None] for each in (*trajectory.sample(times)[1:], trajectory.jerks(times))]
        slope, bend, twist = states  # each (rows, samples, J, 1)
        speed = np.sqrt(np.arange(_NODES + 1) / _NODES)
        limit, jerk = self._acceleration[:, None], self._jerk[:, None]
        own, own_jerk = bend * speed**2, twist * speed**3
        most = np.maximum(limit, np.abs(own)) + _SLACK * limit
        most_jerk = np.where(np.abs(own_jerk) <= 1.01 * jerk, np.maximum(jerk, np.abs(own_jerk)), np.abs(own_jerk) + jerk)
        most_jerk = most_jerk + _SLACK * jerk
        bends = 3 * bend * speed
        rates = []
        for sign in (-1, 1):
            by_acceleration = _room(most, own, sign * slope)
            by_jerk = _room(most_jerk, own_jerk, sign * bends)
            rates.append(np.minimum(np.minimum(by_acceleration, by_jerk).min(axis=(1, 2)), _MOST_RATE))
        tables = []
        for sign, rate in zip((-1, 1), rates, strict=True):
            columns = [rate]
            for way in (sign, -sign):
                for a in (np.zeros_like(rate), sign * rate):
                    room = _room(most_jerk, own_jerk + bends * a[:, None, None], way * slope)
                    columns.append(room.min(axis=(1, 2)).clip(0.0, _MOST_CHANGE))
            tables.append(np.stack(columns, axis=-1).tolist())
        return tables[0], tables[1]


def _room(most: Array, own: Array, factor: Array) -> Array:
    """The greatest x >= 0 with |own + factor x| <= most."""
    return np.asarray((most - np.sign(factor) * own) / np.maximum(np.abs(factor), _STANDING))


def _between(first: float, last: float, rate: float, most: float) -> float:
    share = min(rate / most, 1.0) if most > 0.0 else 1.0
    return first + share * (last - first)
