"""A timed motion as a function of time: quintic polynomials through the samples of a trajectory."""

from __future__ import annotations

from bisect import bisect_right
from functools import cached_property

import numpy as np
import numpy.typing as npt

from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import Trajectory

Array = npt.NDArray[np.float64]

_QUINTIC = np.array(
    # p0    v0    a0    p1    v1    a1
    [
        [1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [0.0, 1.0, 0.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.5, 0.0, 0.0, 0.0],
        [-10.0, -6.0, -1.5, 10.0, -4.0, 0.5],
        [15.0, 8.0, 1.5, -15.0, 7.0, -1.0],
        [-6.0, -3.0, -0.5, 6.0, -3.0, 0.5],
    ]
)
"""Coefficients, lowest power first, of the quintic on [0, 1] that meets position, velocity and acceleration at both
ends (Hermite interpolation: six conditions, six coefficients)."""


def quintics(begin: Array, end: Array, step: Array) -> Array:
    """Coefficients (N, 6, J), lowest power first, of the quintics over times of length `step` (N,) s scaled to [0, 1].

    `begin` and `end` (3, N, J) are their positions, velocities and accelerations at both ends.
    """
    step = step[:, None]
    conditions = [part for state in (begin, end) for part in (state[0], state[1] * step, state[2] * step**2)]
    coefficients: Array = np.einsum("ij,jnk->nik", _QUINTIC, np.stack(conditions))
    return coefficients


class TimedTrajectory:
    """A motion of J joints sampled at N times.

    `time` (N,) in s, strictly increasing, from 0 except for a motion whose past was forgotten; `position`, `velocity`, `acceleration` (N, J) in rad, rad/s, rad/s^2.
    Between samples it is the quintic that meets all three at both ends, as `Trajectory` defines it. `start` and `end` are
    the joint positions (J,) at the two ends.
    """

    def __init__(self, time: Array, position: Array, velocity: Array, acceleration: Array) -> None:
        self.time = time
        self.position = position
        self.velocity = velocity
        self.acceleration = acceleration
        self.start: Array = position[0]
        self.end: Array = position[-1]
        self.duration = float(time[-1])
        self._knots: list[float] = time.tolist()

    @classmethod
    def of(cls, trajectory: Trajectory, joints: tuple[str, ...]) -> TimedTrajectory:
        """The motion of `joints`, in this order, whatever the order in the trajectory.

        Raises InvalidRequest where the trajectory does not name exactly these joints, or has samples too close in time
        to divide by.
        """
        named = trajectory.joint_names
        if sorted(named) != sorted(joints):
            raise InvalidRequest(
                f"the trajectory moves {', '.join(named) or 'no joint'}; this robot needs each of {', '.join(joints)} once",
                field="trajectory.joint_names",
            )
        order = [named.index(joint) for joint in joints]
        time = np.array(trajectory.time)
        if not np.all(np.diff(time) >= SHORTEST):
            raise InvalidRequest(
                f"the samples are less than {SHORTEST:g} s apart; leave some out", field="trajectory.time"
            )
        return cls(
            time,
            np.array(trajectory.position)[:, order],
            np.array(trajectory.velocity)[:, order],
            np.array(trajectory.acceleration)[:, order],
        )

    @classmethod
    def standing(cls, position: Array) -> TimedTrajectory:
        """A second of rest at `position` (J,)."""
        still = np.zeros((2, len(position)))
        return cls(np.array([0.0, 1.0]), np.vstack((position, position)), still, still)

    @cached_property
    def steps(self) -> Array:
        """Length (N-1,) of each segment in s."""
        return np.diff(self.time)

    @cached_property
    def coefficients(self) -> Array:
        """Coefficients (N-1, 6, J), lowest power first, of each segment's position over its own time scaled to [0, 1]."""
        states = self.states
        return quintics(states[:, :-1], states[:, 1:], self.steps)

    @property
    def states(self) -> Array:
        """Position, velocity and acceleration (3, N, J) at the samples."""
        return np.stack((self.position, self.velocity, self.acceleration))

    def at(self, time: float) -> Array:
        """Position, velocity and acceleration as rows of a (3, J) array; `time` (s) outside the path is its nearest end."""
        time = min(max(time, self._knots[0]), self.duration)
        index = min(bisect_right(self._knots, time), len(self._knots) - 1) - 1
        begin, end = self._knots[index], self._knots[index + 1]
        step = end - begin
        u = (time - begin) / step
        u2, u3, u4 = u * u, u**3, u**4
        powers = np.array(
            (
                (1.0, u, u2, u3, u4, u4 * u),
                (0.0, 1.0 / step, 2 * u / step, 3 * u2 / step, 4 * u3 / step, 5 * u4 / step),
                (0.0, 0.0, 2 / step**2, 6 * u / step**2, 12 * u2 / step**2, 20 * u3 / step**2),
            )
        )
        rows: Array = powers @ self.coefficients[index]
        return rows

    def sample(self, times: Array) -> Array:
        """Position, velocity and acceleration (3, N, J) at N path times (N,) inside the path, as `at` gives them."""
        index = np.clip(np.searchsorted(self.time, times, side="right") - 1, 0, len(self.time) - 2)
        step = self.steps[index]
        u = (times - self.time[index]) / step
        one, none = np.ones_like(u), np.zeros_like(u)
        powers = np.array(
            (
                (one, u, u**2, u**3, u**4, u**5),
                (none, one, 2 * u, 3 * u**2, 4 * u**3, 5 * u**4) / step,
                (none, none, 2 * one, 6 * u, 12 * u**2, 20 * u**3) / step**2,
            )
        )
        rows: Array = np.einsum("dkn,nkj->dnj", powers, self.coefficients[index])
        return rows

    def nearest(self, position: Array, first: float, last: float) -> float:
        """The path time from `first` to `last` s at which the path is nearest to `position` (J,), to 1 ms."""
        times = np.append(np.arange(first, last, 0.001), last).clip(self._knots[0], self.duration)
        distance = np.abs(self.sample(times)[0] - position).max(axis=1)
        return float(times[distance.argmin()])

    def shifted(self, offset: Array) -> TimedTrajectory:
        """The same motion with `offset` (J,) rad added to every position."""
        return TimedTrajectory(self.time, self.position + offset, self.velocity, self.acceleration)

    def approached_from(
        self, position: Array, velocity_limit: Array, acceleration_limit: Array, jerk_limit: Array
    ) -> TimedTrajectory:
        """This path with a motion from rest at `position` (J,) to its start before it, inside these limits (J,).

        The robot may stand a tolerance away from where the path starts; jumping there would break every limit. The
        quintic from rest to rest over the distance d in time T peaks at 15/8 d/T, 10/sqrt(3) d/T^2 and 60 d/T^3. Where the
        path starts with an acceleration, reaching that adds to the second by `_SWING` of it.
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
        return TimedTrajectory(
            np.concatenate(([0.0], self.time + time)),
            np.vstack((position, self.position)),
            np.vstack((rest, self.velocity)),
            np.vstack((rest, self.acceleration)),
        )


_SWING = 0.375
"""The quintic from rest to a point with the acceleration a, without any distance, reaches -0.374 a on its way there: the least value
of 3 u - 12 u^2 + 10 u^3."""
SHORTEST = 1e-6
"""Least time between two samples, s."""
NEGLIGIBLE = 1e-6
"""Distance (rad) that a robot may jump in one tick: 0.01 rad/s^2 at 100 Hz, under the noise of any encoder."""
