"""Bounds on changes of the path speed that keep the joint limits of acceleration and jerk.

The commanded motion is q(s(t)) with path time s, path speed sigma = ds/dt, its rate a = dsigma/dt and u = da/dt. By the chain rule

    acceleration  q'' sigma^2 + q' a
    jerk          q''' sigma^3 + 3 q'' sigma a + q' u

(Bobrow, Dubowsky and Gibson 1985; Tarkiainen and Shiller 1993). Both are linear in a and u, so at one point of the trajectory and one path
speed the limits of all joints are an interval of a, and one of u for each a. Zero is in both: a trajectory inside the limits is inside them
at every constant path speed below 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from zarm_contract.descriptor import RobotDescriptor
from zarm_trajectory.arrays import Array
from zarm_trajectory.trajectory import TimedTrajectory

ROW = 0.01
"""Path time (s) over which the bounds are constant."""
_ROWS = 20
"""Rows looked up at once."""
_SAMPLES = 8
"""Samples of the trajectory per row."""
_NODES = 6
"""The bounds are interpolated between this many squared path speeds from 0 to 1. They are concave in them, so that is
conservative.
"""
_SLACK = 0.001
"""Share of a limit that a change of path speed may use where the trajectory alone needs all of it: too little to
measure.
"""
_BEYOND = 1.01
"""A trajectory whose jerk exceeds the limit by more than this factor comes from a source that ignores it."""
_MIN_SLOPE = 1e-9
"""Slope of a trajectory (rad/s) below which a joint does not constrain the path speed."""
_UNBOUNDED = 1e6
"""Bound where no joint is a constraint."""

_KEPT = 200
"""Multiples of `_ROWS` remembered, of either way: 9 MB for six joints."""
_PREPARED = 50
"""Multiples of `_ROWS` looked up by `prepare`: 10 s of the trajectory, in some 50 ms."""

_Table = list[list[list[float]]]
"""By row and node: the bound on the rate from the accelerations, that on the rate times the path speed from the jerks,
how fast the rate may grow and fall at zero, and by how much less for each unit of the rate times the path speed; then
how much each of these six is greater at the next node.
"""


@dataclass(frozen=True, eq=False)
class RateLimits:
    """What bounds the rate of a path speed: the joints' limits (J,) of `acceleration` (rad/s^2) and `jerk` (rad/s^3)."""

    acceleration: Array
    jerk: Array

    @staticmethod
    def of(descriptor: RobotDescriptor) -> RateLimits:
        """Those of the descriptor; the same object for the same limits."""
        return _limits(tuple(descriptor.cspace.acceleration), tuple(descriptor.cspace.jerk))

    @property
    def ramp(self) -> float:
        """The longest time (s) that a joint takes from no acceleration to its limit."""
        return float((self.acceleration / self.jerk).max())


@lru_cache(32)
def _limits(acceleration: tuple[float, ...], jerk: tuple[float, ...]) -> RateLimits:
    return RateLimits(np.array(acceleration), np.array(jerk))


Bounds = tuple[float, float, float, float, float]
"""For one direction of change: the greatest rate (1/s), how fast it may grow and shrink near zero (1/s^2), and by how
much less for each unit of it.
"""


def rate_after(bounds: Bounds, rate: float, dt: float) -> float:
    """The greatest rate that `rate` may become within `dt` s."""
    most, grow, _, loss, _ = bounds
    return min(rate + (grow - loss * rate) * dt, (rate + grow * dt) / (1.0 + loss * dt), most)


def ease(bounds: Bounds, rate: float) -> float:
    """How fast this rate, and any lower one, may fall towards zero."""
    left = bounds[2] - bounds[4] * rate
    return left if left > 0.0 else 0.0


class RateBounds:
    """The bounds along `trajectory` inside these limits.

    Where the trajectory itself exceeds a limit, that is allowed; where its jerk does, a change of path speed may add up
    to the limit.
    """

    def __init__(self, trajectory: TimedTrajectory, limits: RateLimits) -> None:
        self._trajectory, self._limits = trajectory, limits
        self._tables: dict[tuple[int, int], _Table] = {}

    @staticmethod
    @lru_cache(4)
    def of(trajectory: TimedTrajectory, limits: RateLimits) -> RateBounds:
        """The bounds, including what recent users have already looked up."""
        return RateBounds(trajectory, limits)

    def prepare(self) -> None:
        """Look up what the first seconds of a motion need, 0.9 ms for each 0.2 s of it: better here than in the control
        loop.
        """
        for block in range(min(int(self._trajectory.duration / (ROW * _ROWS)) + 1, _PREPARED)):
            for way in (-1, 1):
                self._block(block, way)

    def at(self, row: int, speed: float, way: int) -> Bounds:
        """The bounds in a row, from the path time `row` x ROW (s) on, for slowing down (`way` -1) or speeding up (1)."""
        block = row // _ROWS
        table = self._tables.get((block, way)) or self._block(block, way)
        node = speed * speed * _NODES
        low = int(node) if node < _NODES else _NODES - 1
        part = node - low
        rate, product, grow, shrink, grow_loss, shrink_loss, b0, b1, b2, b3, b4, b5 = table[row % _ROWS][low]
        rate, product = rate + part * b0, (product + part * b1) / (speed if speed > 1e-6 else 1e-6)
        return (
            rate if rate < product else product,
            grow + part * b2,
            shrink + part * b3,
            (grow_loss + part * b4) * speed,
            (shrink_loss + part * b5) * speed,
        )

    def _block(self, block: int, way: int) -> _Table:
        if (block, way) not in self._tables:
            table = self._look_up(block * _ROWS, way)
            self._tables = {**dict(list(self._tables.items())[1 - _KEPT :]), (block, way): table}
        return self._tables[block, way]

    def _look_up(self, first: int, way: int) -> _Table:
        trajectory, limit, jerk = self._trajectory, self._limits.acceleration, self._limits.jerk
        times = ROW * (first + np.arange(_ROWS * _SAMPLES + 1) / _SAMPLES)
        times = times.clip(trajectory.begin, trajectory.duration)
        samples = np.arange(_ROWS)[:, None] * _SAMPLES + np.arange(_SAMPLES + 1)  # of each row, including both its ends
        _, slope, bend = trajectory.sample(times)[:, samples]
        twist = trajectory.jerks(times)[samples]
        least_jerk = np.where(np.abs(twist) > _BEYOND * jerk, jerk, _SLACK * jerk)
        most_jerk = (1 + _SLACK) * jerk
        turn = 3 * bend
        by_slope, by_turn = 1.0 / np.maximum(np.abs(slope), _MIN_SLOPE), 1.0 / np.maximum(np.abs(turn), _MIN_SLOPE)
        leaning, turning = np.sign(slope) * by_slope, np.sign(turn) * by_turn
        rate = _remaining((1 + _SLACK) * limit * by_slope, _SLACK * limit * by_slope, (way * bend * leaning, _SQUARED))
        product = _remaining(most_jerk * by_turn, least_jerk * by_turn, (way * twist * turning, _CUBED))
        reach = np.minimum(rate * np.sqrt(np.maximum(_SQUARED, _SQUARED[1])), product)
        columns, losses = [rate, product], []
        for sign in (way, -way):
            of_trajectory, of_rate = (sign * twist * leaning, _CUBED), (sign * way * turn * leaning, reach)
            near = _remaining(most_jerk * by_slope, least_jerk * by_slope, of_trajectory)
            far = _remaining(most_jerk * by_slope, least_jerk * by_slope, of_trajectory, of_rate)
            columns.append(near)
            losses.append(np.maximum(near - far, 0.0) / np.maximum(reach, _MIN_SLOPE))
        cells = np.stack(columns + losses, axis=-1)
        table: _Table = np.concatenate((cells[:, :-1], np.diff(cells, axis=1)), axis=2).tolist()
        return table


_SQUARED = np.arange(_NODES + 1.0) / _NODES
_CUBED = _SQUARED**1.5


def _remaining(most: Array, least: Array, *uses: tuple[Array, Array]) -> Array:
    """What every joint of every sample has left of `most` at the nodes (rows, nodes), at least `least`.

    Each use (rows, samples, J) is multiplied by a factor per node, (nodes,) or (rows, nodes); `most` and `least` are
    (rows, samples, J) too.
    """
    flat = (len(most), -1)
    most, least = most.reshape(flat), least.reshape(flat)
    remaining = np.empty((len(most), _NODES + 1))
    # All nodes at once make arrays that the executor's allocator, see its `LARGE`, gets from the system and gives back each time.
    for node in range(_NODES + 1):
        left = most
        for used, share in uses:
            left = left - used.reshape(flat) * share[..., node, None]
        np.maximum(left, least).min(axis=1, out=remaining[:, node])
    return remaining.clip(0.0, _UNBOUNDED)
