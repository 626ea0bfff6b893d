"""Moving along a trajectory at a path speed that falls and rises as fast as the joints' acceleration limits allow.

The commanded motion is q(s(t)) with path time s and path speed sigma = ds/dt in [0, 1], so the robot stays on the
verified path while it brakes or its speed is scaled. Its acceleration is q''(s) sigma^2 + q'(s) dsigma/dt (chain rule; Bobrow, Dubowsky and
Gibson 1985). A trajectory inside the limits at sigma = 1 is inside them at every constant sigma below, so holding the speed is
always allowed, and braking as hard as possible now never leads into a state without a way on.
"""

from __future__ import annotations

import copy
import math

import numpy as np

from zarm_contract.errors import InternalError
from zarm_trajectory.quintic import Array
from zarm_trajectory.retimed import RetimedTrajectory
from zarm_trajectory.trajectory import TimedTrajectory

TICK = 0.01
"""Longest step, s, in which time passes for a follower: the longest period of the control loop (100 Hz)."""
CATCH_UP = 0.1
"""A pause between ticks up to this long (s) is caught up with; after a longer one the motion goes on from rest where it
stood, because nobody commanded the robot meanwhile."""
_HALVINGS = 20
"""So often at most a change of path speed is halved until it is inside the limits: to a millionth."""
_SLOWEST = 0.01
"""What takes longer (x the duration of the trajectory) than at this path speed is no motion, but a fault of the follower."""


class Follower:
    """Where a robot with these acceleration limits (J,) rad/s^2 is on a trajectory, and how fast it goes along it.

    It begins at the path time `time` (s) with the path speed `speed` (sigma), and `target` is the path speed wanted: 1 to
    move as planned, less to move slower, 0 to rest. `position` (rad) and `velocity` (rad/s) are the commanded joints (J,).
    """

    def __init__(
        self,
        trajectory: TimedTrajectory,
        acceleration_limit: Array,
        *,
        time: float = 0.0,
        speed: float = 1.0,
        target: float = 1.0,
    ) -> None:
        self.trajectory = trajectory
        self.time = time
        self.speed = speed
        self.target = target
        self._limit = acceleration_limit
        self._reach()

    @property
    def finished(self) -> bool:
        """Whether the end of the trajectory is reached."""
        return self.time >= self.trajectory.duration

    @property
    def at_rest(self) -> bool:
        """Whether the commanded robot stands still: held, or at the end of the trajectory."""
        return self.speed == 0.0 or self.finished

    @property
    def settled(self) -> bool:
        """Whether the passing of time changes nothing."""
        return self.finished or self.speed == self.target == 0.0

    def advance(self, dt: float) -> None:
        """Let `dt` seconds pass."""
        if dt > CATCH_UP:
            self.speed = 0.0
            self._reach()
            return
        while dt > 1e-9 and not self.settled:
            step = min(dt, TICK)
            self._step(step)
            dt -= step

    def join(self, trajectory: TimedTrajectory) -> None:
        """Go on along `trajectory`, which is at `time` where the present one is there."""
        self.trajectory = trajectory
        self._reach()

    def ahead(self, dt: float, count: int | None = None) -> RetimedTrajectory:
        """What lies ahead from now on, a point every `dt` s: `count` points, or all until nothing changes any more.

        Raises InternalError where that is without end.
        """
        scout = copy.copy(self)
        rows: list[tuple[float, float, Array]] = []
        for _ in range(math.ceil(self.trajectory.duration / (_SLOWEST * dt)) if count is None else count):
            rows.append((scout.time, scout.speed, scout._state))
            if count is None and (scout.settled or scout.speed == scout.target):
                break
            scout.advance(min(dt, CATCH_UP))
        else:
            if count is None:
                raise InternalError(f"the path speed does not come from {self.speed:g} to {self.target:g}")
        time = np.array([row[0] for row in rows])
        speed = np.array([row[1] for row in rows])
        states = np.stack([row[2] for row in rows], axis=1)
        if not scout.settled and count is None:  # at constant speed from here: all points at once
            rest = np.arange(scout.time, self.trajectory.duration, dt * scout.speed)[1:]
            rest = np.append(rest, self.trajectory.duration)
            time, states = np.concatenate((time, rest)), np.concatenate((states, self.trajectory.sample(rest)), axis=1)
            speed = np.concatenate((speed, np.full(len(rest), scout.speed)))
        position, slope, bend = states
        rate = np.append(np.diff(speed), 0.0)[:, None] / dt
        speed[time >= self.trajectory.duration] = 0.0
        return RetimedTrajectory.of(
            dt, time, speed, position, slope * speed[:, None], bend * speed[:, None] ** 2 + slope * rate
        )

    def _reach(self) -> None:
        self._state = self.trajectory.at(self.time)
        self.position: Array = self._state[0]
        self.velocity: Array = self._state[1] * (0.0 if self.at_rest else self.speed)

    def _step(self, dt: float) -> None:
        rate = 0.0 if self.speed == self.target else self._rate(dt)
        speed = min(max(self.speed + rate * dt, 0.0), 1.0)
        if abs(speed - self.target) < 1e-9:
            speed = self.target
        self.time = min(self.time + 0.5 * (self.speed + speed) * dt, self.trajectory.duration)
        self.speed = speed
        self._reach()

    def _rate(self, dt: float) -> float:
        """The change of path speed, 1/s, nearest to what reaches the target within `dt` and inside the limits."""
        wanted = (self.target - self.speed) / dt
        low, high = self._bounds(self._state, self.speed)
        wanted = rate = min(max(wanted, low), high)
        # The path bends within the tick too, so the limits must also hold where the tick ends.
        for low, high in self._bounds_after(rate, dt):
            rate = min(max(rate, low), high)
        if rate == wanted or wanted <= 0.0:
            return rate
        # Where the whole of it is too much a part may do: from rest, at full path speed, the trajectory alone may need every limit.
        part = wanted / 2
        for _ in range(_HALVINGS):
            if part <= rate or all(part <= high for _, high in self._bounds_after(part, dt)):
                break
            part /= 2
        else:
            return rate
        return max(rate, part)

    def _bounds_after(self, rate: float, dt: float) -> list[tuple[float, float]]:
        """The bounds of the rate where `dt` at this one leads, at the path speed before and after it."""
        speed = min(max(self.speed + rate * dt, 0.0), 1.0)
        ahead = self.trajectory.at(self.time + 0.5 * (self.speed + speed) * dt)
        return [self._bounds(ahead, sigma) for sigma in (self.speed, speed)]

    def _bounds(self, state: Array, speed: float) -> tuple[float, float]:
        """The least and greatest dsigma/dt that keep every joint inside its limit at this point; 0 is always inside."""
        velocity, needed = state[1], state[2] * speed**2
        moving = np.abs(velocity) > 1e-9
        if not moving.any():
            return -np.inf, np.inf
        slope = velocity[moving]
        ends = np.stack(((-self._limit - needed)[moving] / slope, (self._limit - needed)[moving] / slope))
        return min(float(ends.min(axis=0).max()), 0.0), max(float(ends.max(axis=0).min()), 0.0)
