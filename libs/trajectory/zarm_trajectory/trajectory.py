"""The timed trajectory: joint positions, velocities and accelerations as a function of time."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import Trajectory
from zarm_trajectory import quintic
from zarm_trajectory.arrays import Array


@dataclass(frozen=True, eq=False)
class TimedTrajectory:
    """A motion of J joints sampled at N times.

    `time` (N,) in s, strictly increasing, from 0 unless the past of a motion was dropped; `position`, `velocity`,
    `acceleration` (N, J) in rad, rad/s, rad/s^2. Between samples it is the quintic that meets all three at both ends,
    as `zarm_contract.messages.Trajectory` defines it.
    """

    time: Array
    position: Array
    velocity: Array
    acceleration: Array

    @classmethod
    def of(cls, trajectory: Trajectory, joints: tuple[str, ...]) -> Self:
        """The motion of `joints`, in this order, whatever the order in the message.

        Raises InvalidRequest if the message does not name exactly these joints, or has samples too close in time to
        divide by.
        """
        named = trajectory.joint_names
        if sorted(named) != sorted(joints):
            raise InvalidRequest(
                f"the trajectory moves {', '.join(named) or 'no joint'}; this robot needs each of {', '.join(joints)} once",
                field="trajectory.joint_names",
            )
        time = np.array(trajectory.time)
        if not np.all(np.diff(time) >= MIN_INTERVAL):
            raise InvalidRequest(
                f"the samples are less than {MIN_INTERVAL:g} s apart; leave some out", field="trajectory.time"
            )
        order = [named.index(joint) for joint in joints]
        shape = len(time), len(joints)
        rows = (trajectory.position, trajectory.velocity, trajectory.acceleration)
        return cls(time, *(_numbers(each, time.size * len(joints)).reshape(shape)[:, order] for each in rows))

    @classmethod
    def standing(cls, position: Array, duration: float = 1.0) -> Self:
        """Rest at `position` (J,) for `duration` s."""
        return cls(np.array([0.0, duration]), np.stack((position, position)), *np.zeros((2, 2, len(position))))

    def message(self, joints: tuple[str, ...]) -> Trajectory:
        """The motion as a message to be sent, without validation; `joints` names the columns.

        Its numbers stay in arrays, which `zarm_contract.codec.encode` writes at once.
        """
        columns = self.time, self.position, self.velocity, self.acceleration
        arrays: list[Any] = [np.ascontiguousarray(column) for column in columns]  # orjson writes no others
        time, position, velocity, acceleration = arrays
        return Trajectory.model_construct(
            joint_names=joints, time=time, position=position, velocity=velocity, acceleration=acceleration
        )

    @property
    def begin(self) -> float:
        """The time of the first sample, s."""
        return float(self.time[0])

    @cached_property
    def duration(self) -> float:
        """The time of the last sample, s."""
        return float(self.time[-1])

    @property
    def start(self) -> Array:
        """Its first position, (J,) rad."""
        return np.asarray(self.position[0])

    @property
    def end(self) -> Array:
        """Its last position, (J,) rad."""
        return np.asarray(self.position[-1])

    @property
    def length(self) -> float:
        """Length of the path in joint space (rad, Euclidean), sample by sample."""
        steps = self.position[1:] - self.position[:-1]
        return float(np.sqrt(np.einsum("ij,ij->i", steps, steps)).sum())

    @cached_property
    def steps(self) -> Array:
        """Length (N-1,) of each segment in s."""
        return np.diff(self.time)

    @cached_property
    def coefficients(self) -> Array:
        """Coefficients (6, N-1, J) of each segment's position, as in `quintic`."""
        states = self.states
        return quintic.coefficients(states[:, :-1], states[:, 1:], self.steps)

    @property
    def states(self) -> Array:
        """Position, velocity and acceleration (3, N, J) at the samples."""
        return np.stack((self.position, self.velocity, self.acceleration))

    def at(self, time: float) -> Array:
        """Position, velocity and acceleration as rows of a (3, J) array; for `time` (s) outside the trajectory, those
        at the nearest end.
        """
        knots = self._knots
        time = min(max(time, knots[0]), knots[-1])
        index = min(bisect_right(knots, time), len(knots) - 1) - 1
        begin, end = knots[index], knots[index + 1]
        rows = self.position, self.velocity, self.acceleration
        here, there = [each[index] for each in rows], [each[index + 1] for each in rows]
        return quintic.state(here, there, end - begin, (time - begin) / (end - begin))

    def sample(self, times: Array) -> Array:
        """Position, velocity and acceleration (3, K, J) at `times` (K,) within the trajectory, as `at` returns them."""
        coefficients, u, step = self._pieces(times)
        position, velocity, acceleration = quintic.states(coefficients, u)
        return np.stack((position, velocity / step, acceleration / step**2))

    def positions(self, times: Array) -> Array:
        """Positions (K, J) at `times` (K,) within the trajectory."""
        coefficients, u, _ = self._pieces(times)
        return quintic.values(coefficients, u)

    def jerks(self, times: Array) -> Array:
        """Jerks (K, J) in rad/s^3 at `times` (K,) within the trajectory; at a sample, the jerk after it."""
        (_, _, _, c3, c4, c5), u, step = self._pieces(times)
        return np.asarray((6 * c3 + u * (24 * c4 + 60 * u * c5)) / step**3)

    def nearest(self, position: Array, first: float, last: float) -> float:
        """The time from `first` to `last` s at which the trajectory is nearest to `position` (J,), to 1 ms."""
        times = np.append(np.arange(first, last, 0.001), last).clip(self.time[0], self.duration)
        distance = np.abs(self.positions(times) - position).max(axis=1)
        return float(times[distance.argmin()])

    def shifted(self, offset: Array) -> Self:
        """The same motion with `offset` (J,) rad added to every position."""
        return type(self)(self.time, self.position + offset, self.velocity, self.acceleration)

    def begun_at(self, offset: float) -> Self:
        """The same motion with `offset` s added to every time."""
        return type(self)(self.time + offset, self.position, self.velocity, self.acceleration)

    def since(self, time: float) -> Self:
        """The same motion without the samples before the last one at or before `time` (s); at least two are kept."""
        first = min(max(0, int(np.searchsorted(self.time, time, side="right")) - 1), len(self.time) - 2)
        return type(self)(self.time[first:], self.position[first:], self.velocity[first:], self.acceleration[first:])

    def rest(self, time: float) -> Self:
        """What is left of the motion at `time` (s), which is before its end: from time 0 on, beginning in the state that it has then."""
        later = self.time > time + _MIN_INTERVAL_AT_REST
        states = np.concatenate([self.at(time)[:, None], self.states[:, later]], axis=1)
        return type(self)(np.concatenate([[0.0], self.time[later] - time]), *states)

    def columns(self, which: slice) -> Self:
        """The motion of some of the joints alone."""
        rows = self.position[:, which], self.velocity[:, which], self.acceleration[:, which]
        return type(self)(self.time, *map(np.ascontiguousarray, rows))

    def slower(self, factor: float) -> Self:
        """The same motion, taking `factor` times as long."""
        return type(self)(self.time * factor, self.position, self.velocity / factor, self.acceleration / factor**2)

    def approached_from(
        self, position: Array, velocity_limit: Array, acceleration_limit: Array, jerk_limit: Array
    ) -> Self:
        """This trajectory, preceded by a motion from rest at `position` (J,) to its start, inside these limits (J,).

        The robot may be a tolerance away from the trajectory's start; jumping there would break every limit. The
        quintic from rest to rest over the distance d in time T peaks at 15/8 d/T, 10/sqrt(3) d/T^2 and 60 d/T^3. If the
        trajectory starts with an acceleration, reaching it adds `_SWING` of it to the second.
        """
        distance = np.abs(self.start - position)
        if distance.max() <= NEGLIGIBLE:
            return self
        acceleration_left = acceleration_limit - _SWING * np.abs(self.acceleration[0])
        time = max(
            float(np.max(15 / 8 * distance / velocity_limit)),
            float(np.max(np.sqrt(10 / np.sqrt(3) * distance / acceleration_left))),
            float(np.max(np.cbrt(60 * distance / jerk_limit))),
        )
        rest = np.zeros((1, len(position)))
        return type(self)(
            np.concatenate(([0.0], self.time + time)),
            np.vstack((position, self.position)),
            np.vstack((rest, self.velocity)),
            np.vstack((rest, self.acceleration)),
        )

    @cached_property
    def _knots(self) -> list[float]:
        return list(self.time.tolist())

    def _pieces(self, times: Array) -> tuple[Array, Array, Array]:
        """The segments that contain the times (K,): their coefficients (6, K, J), the elapsed shares (K, 1) of them,
        and their lengths (K, 1) in s.
        """
        index = np.clip(np.searchsorted(self.time, times, side="right") - 1, 0, len(self.time) - 2)
        step = self.steps[index]
        if "coefficients" not in vars(self) and _SPARSE_FACTOR * len(times) < len(
            self.steps
        ):  # often no others are ever needed
            begin, end = self._states_at(index), self._states_at(index + 1)
            coefficients = quintic.coefficients(begin, end, step)
        else:
            coefficients = self.coefficients[:, index]
        return coefficients, ((times - self.time[index]) / step)[:, None], step[:, None]

    def _states_at(self, index: npt.NDArray[np.intp]) -> Array:
        return np.stack((self.position[index], self.velocity[index], self.acceleration[index]))


def _numbers(rows: Any, count: int) -> Array:
    """The numbers in rows of a message, (`count`,)."""
    if isinstance(rows, np.ndarray):  # as `TimedTrajectory.message` leaves them
        return rows.ravel()
    # NumPy would process every row twice, which takes three times as long.
    return np.fromiter(chain.from_iterable(rows), float, count=count)


_SWING = 0.375
"""The quintic from rest to a point with the acceleration a, over no distance, reaches -0.374 a on its way: the minimum
of 3 u - 12 u^2 + 10 u^3.
"""
_MIN_INTERVAL_AT_REST = 1e-3
"""Samples that follow the beginning of a rest by less than this (s) are left out."""
_SPARSE_FACTOR = 8
"""As long as so many times fewer segments than there are were asked for at once, only those are computed."""
MIN_INTERVAL = 1e-6
"""Least time between two samples, s."""
NEGLIGIBLE = 1e-6
"""Distance (rad) that a robot may jump in one tick: 0.01 rad/s^2 at 100 Hz, below the noise of any encoder."""
