"""Follows a trajectory at a path speed that changes as fast as the joint limits of acceleration and jerk allow.

The commanded motion is q(s(t)) with path time s and path speed sigma = ds/dt in [0, 1], so the robot stays on the
verified path while it brakes or its speed is scaled. Within a step the rate of the path speed changes at a constant
rate.

Priorities if not everything can be kept: the robot stays on its path and never goes back on it; then jerk; then
acceleration. `rate_bounds.py` derives the bounds on the rate from the limits. A trajectory inside the limits is inside
them at every constant path speed below 1, so keeping the path speed is always allowed, and a rate is adopted only if
there is a way back from it to a constant speed.
"""

from __future__ import annotations

import copy
import math
from typing import NamedTuple, Self

import numpy as np

from zarm_contract.errors import InternalError
from zarm_trajectory.arrays import Array
from zarm_trajectory.path_state import PathState
from zarm_trajectory.rate_bounds import ROW, RateBounds, RateLimits, ease, rate_after
from zarm_trajectory.retimed import RetimedTrajectory
from zarm_trajectory.trajectory import TimedTrajectory

TICK = 0.01
"""Longest time step (s) of a follower: the longest period of the control loop (100 Hz)."""
CATCH_UP = 0.1
"""A pause between ticks up to this long (s) is caught up; after a longer one the motion continues from rest where it
stood, because nobody commanded the robot meanwhile.
"""
_SLOWEST = 0.01
"""Needing longer than the trajectory's duration at this path speed indicates a fault of the follower."""
_LEAST_RATE_CHANGE = 1e-3
"""Least change of the rate, 1/s^2, with which it is brought back to zero when the path speed has almost reached its
target.
"""
_MAX_ROWS_AHEAD = 10
"""Most rows ahead in which a way back to a constant speed is searched."""
_INSTANT = 1e-9
"""A time (s) in which nothing happens."""
_SPEED_TOLERANCE = 1e-9
"""A path speed this close to its target has reached it."""


class Follower:
    """The position of a robot with these limits on a trajectory, and its speed along it.

    It begins at the path time `time` (s) with the path speed `speed` (sigma), which changes at `rate` (1/s), and
    `target` is the wanted path speed: 1 to move as planned, less to move slower, 0 to rest. `position` (rad) and
    `velocity` (rad/s) are the commanded joints (J,).
    """

    def __init__(
        self,
        trajectory: TimedTrajectory,
        limits: RateLimits,
        *,
        time: float = 0.0,
        speed: float = 1.0,
        rate: float = 0.0,
        target: float = 1.0,
    ) -> None:
        self.trajectory = trajectory
        self.time = time
        self.speed = speed
        self.rate = rate
        self.target = target
        self._limits = limits
        self._ahead = min(2 + math.ceil(2 * limits.ramp / ROW), _MAX_ROWS_AHEAD)
        self._bounds = RateBounds.of(trajectory, limits)
        self._step: _Step | None = None
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
        """Whether time no longer changes anything."""
        return self.finished or self.speed == self.target == 0.0

    @property
    def steady(self) -> bool:
        """Whether the path speed is at its target and constant."""
        return self.speed == self.target and self.rate == 0.0

    def advance(self, dt: float) -> None:
        """Let `dt` seconds pass."""
        if dt > CATCH_UP:
            self.speed = self.rate = 0.0
            self._step = None
        else:
            self._move(dt)
        self._reach()

    @property
    def state(self) -> PathState:
        """The present path state."""
        return PathState(self.time, self.speed, self.rate)

    def moved_to(self, state: PathState, target: float) -> Self:
        """Another follower of the same trajectory, in this state."""
        other = self._scout(state, target)
        other._reach()
        return other

    def braking(self, dt: float) -> RetimedTrajectory:
        """How the robot comes to rest when told to stop now, a point every `dt` s: the single definition of a stop."""
        return self._scout(self.state, 0.0).ahead(dt)

    def rest(self, state: PathState, dt: float) -> tuple[float, float]:
        """How long (s) a robot takes that brakes from this state, in whole steps of `dt` s, and the path time (s) at
        which it comes to rest.
        """
        rows = self._scout(state, 0.0)._rows(dt)
        return dt * (len(rows) - 1), rows[-1].time

    def join(self, trajectory: TimedTrajectory) -> None:
        """Continue along `trajectory`, which at `time` is where the present one is."""
        self.trajectory = trajectory
        self._bounds = RateBounds.of(trajectory, self._limits)
        self._step = None
        self._reach()

    def ahead(self, dt: float, count: int | None = None) -> RetimedTrajectory:
        """The motion from now on, a point every `dt` s: `count` points, or all until nothing changes any more.

        Raises InternalError if it never ends.
        """
        scout = copy.copy(self)
        time, speed, rate = np.array(scout._rows(dt, count)).T
        if not scout.settled and count is None:  # constant speed from here: all points at once
            rest = np.arange(scout.time, self.trajectory.duration, dt * scout.speed)[1:]
            time = np.concatenate((time, rest, [self.trajectory.duration]))
            speed = np.append(speed, np.full(len(rest) + 1, scout.speed))
            rate = np.append(rate, np.zeros(len(rest) + 1))
        speed[time >= self.trajectory.duration] = 0.0
        return RetimedTrajectory.along(self.trajectory, dt, time, speed, rate)

    def _scout(self, state: PathState, target: float) -> Self:
        """A follower in this state, whose position nobody asks for."""
        other = copy.copy(self)
        other.time, other.speed, other.rate = state
        other.target, other._step = target, None
        return other

    def _rows(self, dt: float, count: int | None = None) -> list[PathState]:
        """Move on, and return the states from now on, one every `dt` s, see `ahead`."""
        rows = []
        for _ in range(math.ceil(self.trajectory.duration / (_SLOWEST * dt)) if count is None else count):
            rows.append(self.state)
            if count is None and (self.settled or self.steady):
                return rows
            self._move(min(dt, CATCH_UP))
        if count is None:
            raise InternalError(f"the path speed does not come from {rows[0].speed:g} to {self.target:g}")
        return rows

    def _reach(self) -> None:
        self._state = self.trajectory.at(self.time)
        self.position: Array = self._state[0]
        self.velocity: Array = self._state[1] * (0.0 if self.at_rest else self.speed)

    def _move(self, dt: float) -> None:
        while dt > _INSTANT and not self.settled:
            if self.steady:
                self._pass(dt, 0.0)
                return
            dt -= self._change(dt)

    def _change(self, dt: float) -> float:
        """Let up to `dt` s pass in which the path speed changes; returns how much.

        A decision holds for `TICK`, or until the target changes, so that the motion does not depend on when it is
        sampled.
        """
        step = self._step
        if step is None or step.target != self.target:
            step = self._decide()
        time = min(dt, step.left)
        self._pass(time, step.change)
        left = step.left - time
        self._step = step._replace(left=left) if left > _INSTANT else None
        if self._step is None and step.level:
            self.rate = 0.0
            if step.there or abs(self.target - self.speed) < _SPEED_TOLERANCE:
                self.speed = self.target
        return time

    def _decide(self) -> _Step:
        gap = self.target - self.speed
        way = 1 if self.rate > 0.0 or (self.rate == 0.0 and gap > 0.0) else -1
        # Slowing down mirrors speeding up: from here on rates and gaps are positive in the direction of `way`.
        view = _View(self, way, TICK)
        needed = view.rate**2 / (2 * way * gap) if way * gap > 0.0 else math.inf
        return self._ease(view) if needed > 1.01 * view.ease else self._approach(view, way * gap, needed)

    def _ease(self, view: _View) -> _Step:
        """Bring the rate to zero, because the target lies in the other direction or will be overshot."""
        wall = 1.0 - self.speed if view.way > 0 else self.speed
        if wall <= 0.0:  # rounding
            return _Step(0.0, 0.0, self.target, level=True)
        change = max(view.shrink, _LEAST_RATE_CHANGE, view.rate**2 / (2 * wall))
        time = view.rate / change
        return _Step(min(time, TICK), -view.way * change, self.target, level=time < TICK)

    def _approach(self, view: _View, gap: float, needed: float) -> _Step:
        """Approach the target, to meet it with a rate of zero."""
        if 2 * gap <= view.rate * TICK:
            time = 2 * gap / view.rate
            return _Step(time, -view.way * view.rate / time, self.target, level=True, there=True)
        # With this rate a step later, `ease` would end exactly at the target.
        landing = view.ease * (math.sqrt(TICK * TICK / 4 + (2 * gap - view.rate * TICK) / view.ease) - TICK / 2)
        rate = max(min(view.most, landing), view.rate - max(view.shrink, needed) * TICK)
        level = rate < 1e-12 or abs(gap - TICK * (view.rate + rate) / 2) < _SPEED_TOLERANCE
        return _Step(TICK, view.way * (rate - view.rate) / TICK, self.target, level=level)

    def _pass(self, dt: float, change: float) -> None:
        """Let `dt` s pass in which the rate changes by `change` (1/s^3)."""
        self.time = min(
            self.time + dt * (self.speed + dt * (self.rate / 2 + dt * change / 6)), self.trajectory.duration
        )
        self.speed = min(max(self.speed + dt * (self.rate + dt * change / 2), 0.0), 1.0)
        self.rate += dt * change


class _Step(NamedTuple):
    """For the next `left` s the rate changes by `change` (1/s^2 each s); then, if `level`, it is zero, and the target
    is met if `there`.
    """

    left: float
    change: float
    target: float
    level: bool = False
    there: bool = False


class _View:
    """What the limits allow a follower in one direction of change: `way` 1 speeds up, -1 slows down; all is positive in
    that direction.
    """

    def __init__(self, follower: Follower, way: int, dt: float) -> None:
        bounds, speed, now = follower._bounds, follower.speed, way * follower.rate
        row, last = int(follower.time / ROW), int(follower.trajectory.duration / ROW)
        end = min(int((follower.time + speed * dt + max(follower.rate, 0.0) * dt * dt) / ROW), last)
        here = [bounds.at(k, speed, way) for k in range(row, end + 1)]
        most = min([rate_after(each, now, dt) for each in here])
        # The path speed is different at the end of the step.
        speed = min(max(speed + way * (now + most) * dt / 2, 0.0), 1.0)
        there = [bounds.at(k, speed, way) for k in range(row, end + 1)]
        most = min(most, *[rate_after(each, now, dt) for each in there])
        here += there
        shrink = min([ease(each, now) for each in here])
        greatest = max(most, now)
        least = min([ease(each, greatest) for each in here])
        # There must be a way back to what later rows allow, from one step later on.
        place, squared, back = follower.time + follower.speed * dt, speed * speed, least
        recovered, push = -back * TICK, 2.0 if way > 0 else -1.0
        for k in range(end + 1, min(end + follower._ahead, last) + 1):
            way_there, before = max(k * ROW - place, 0.0), speed
            place = k * ROW
            squared = min(max(squared + push * most * way_there, 0.0), 1.0)
            speed = math.sqrt(squared)
            recovered += back * way_there / max(speed, before, 1e-3)
            each = bounds.at(k, speed, way)
            most = min(most, each[0] + max(recovered, 0.0))
            back = ease(each, min(most, each[0]))
            least = min(least, back)
        self.way, self.rate, self.most = way, now, most
        self.shrink, self.ease = shrink, max(least, _LEAST_RATE_CHANGE)
