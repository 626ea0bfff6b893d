"""Path -> trajectory that arrives soon: shortcuts in time at bounded acceleration, then bounded jerk.

A motion that stops at every corner of the path is made faster by replacing pieces of it with the fastest ramps between
their ends, straight or bent (`kernels.smoothing`). A moving average over time then turns steps of acceleration into slopes: an average of
values inside limits is inside them too, and jerk is at most twice the acceleration limit over the window (Biagiotti and
Melchiorri, "FIR filters for online trajectory planning with time- and frequency-domain specifications", 2012).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from zarm_geometry.kernels.arrays import memory
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.deadline import Deadline
from zarm_planner.kernels.ramps import along, make_ramps
from zarm_planner.kernels.sampling import sample_average
from zarm_planner.kernels.smoothing import smooth
from zarm_planner.timing.sampling import sample_times, within
from zarm_trajectory.limits import Limits
from zarm_trajectory.quintic import Array
from zarm_trajectory.trajectory import TimedTrajectory

ATTEMPTS = 1500
"""Shortcuts that are tried for a path, and for each via on top; ten times as many gain 1 % on MotionBenchMaker's problems."""
DEVIATION = 1e-3
"""How far (rad) each joint may be off when a via is passed."""
_ROOM = 256
"""Ramps of a motion at most, on top of one for each edge of the path."""
_MUCH = 0.5
"""A joint that uses less of its speed and acceleration may swing beyond them between two samples, which spares samples."""
_SHORTEST = 0.1
"""Least time to average over, in samples."""
_CLOSE = 1e-5
"""Seconds; samples are further apart, so that their differences can be divided by it."""


class Smoothing:
    """The motion along a path, ever faster with more shortcuts."""

    def __init__(
        self,
        model: RobotModel,
        world: World,
        path: Array,
        limits: Limits,
        dt: float,
        *,
        vias: Sequence[int] = (),
        deviation: float = DEVIATION,
    ) -> None:
        """As in `smooth_path`; the motion rests at each row of `path` until shortcuts are tried."""
        self._model, self._world, self._limits, self._dt, self._path = model, world, limits, dt, path
        strongest = limits.acceleration * (_gentler(limits, dt, deviation) if len(vias) else 1.0)
        self._window = _window(strongest, limits, dt)
        self._bounds = np.stack((model.lower, model.upper, limits.velocity, strongest))
        passed = np.zeros(len(path), np.bool_)
        passed[list(vias)] = True
        self._ramps = make_ramps(len(path) + _ROOM, model.dof)
        self._count = along(path, passed, limits.velocity, strongest, self._ramps)
        self._stretches = 1 + len(vias)

    @property
    def duration(self) -> float:
        """About how long (s) the motion will last."""
        return float(self._ramps.duration[: self._count].sum()) + self._window

    def shortcut(self, attempts: int, seed: int, deadline: Deadline) -> None:
        """Try so many shortcuts, as often again for each via, or fewer where `deadline` comes first."""
        self._count = smooth(
            self._model.arrays,
            self._world.arrays,
            memory(self._model.arrays),
            self._ramps,
            self._count,
            self._bounds,
            attempts * self._stretches,
            np.array([seed], np.uint64),
            deadline.at,
        )

    def trajectory(self) -> TimedTrajectory:
        """The motion as it is now. Raises InvalidRequest where it is longer than `trajectory.MAX_SAMPLES`."""
        if self._count == 0:
            return TimedTrajectory.standing(self._path[0], self._dt)
        return within(self._sample, self._limits)

    def _sample(self, factor: float) -> TimedTrajectory:
        """The motion at `factor` times its shortest duration."""
        t = sample_times(self._knots(), factor, self._dt)
        out = np.empty((3, len(t), self._model.dof))
        sample_average(self._ramps, self._count, self._window, t, out)
        position, velocity, acceleration = out
        velocity[[0, -1]] = acceleration[[0, -1]] = 0.0
        return TimedTrajectory(t * factor, position, velocity / factor, acceleration / factor**2)

    def _knots(self) -> Array:
        """Times (k,) in s between which each joint that uses much of its limits moves along one cubic.

        Samples there describe it exactly; the quintic across a change of jerk would swing beyond the limit.
        """
        duration, _, velocity, acceleration, first, last = (column[: self._count] for column in self._ramps[1:])
        ends = np.cumsum(duration)
        _, _, fastest, strongest = self._bounds
        much = np.abs(velocity + acceleration * first) > _MUCH * fastest
        much |= np.abs(acceleration) > _MUCH * strongest
        up, down = (ends - duration)[:, None] + first, ends[:, None] - last
        steps = np.concatenate(([0.0], ends, up[much], down[much]))
        knots = np.unique(np.concatenate((steps, steps + self._window)))
        knots = knots[np.insert(np.diff(knots) > _CLOSE, 0, True)]
        knots[-1] = self.duration
        return knots


def smooth_path(
    model: RobotModel,
    world: World,
    path: Array,
    limits: Limits,
    dt: float,
    *,
    seed: int,
    deadline: Deadline,
    vias: Sequence[int] = (),
    deviation: float = DEVIATION,
) -> TimedTrajectory:
    """A fast motion from rest to rest from the first to the last row of `path` (n, dof), sampled every `dt` s, and in between
    where a strong acceleration changes.

    It passes the rows `vias` of the path, in their order, each joint within `deviation` (rad), and stops there only where
    no faster way is found to be free. Where it leaves the path it is free of `world` in spheres, as straight edges
    between its configurations every `kernels.smoothing.STEP` s. The limits hold as `TimedTrajectory.load` measures them. The same
    seed gives the same motion; `deadline` only makes the search for a faster one end sooner.

    Raises InvalidRequest where the limits make the motion longer than `trajectory.MAX_SAMPLES`.
    """
    smoothing = Smoothing(model, world, path, limits, dt, vias=vias, deviation=deviation)
    smoothing.shortcut(ATTEMPTS, seed, deadline)
    return smoothing.trajectory()


def least_duration(start: Array, goals: Array, limits: Limits, dt: float) -> float:
    """Seconds that `smooth_path` needs at least from `start` (dof,) to any of `goals` (n, dof), were nothing in the way."""
    way = np.abs(goals - start)
    ramp = limits.velocity**2 / limits.acceleration  # as far a joint gets while it speeds up fully and slows down again
    time = np.where(way < ramp, 2 * np.sqrt(way / limits.acceleration), (way + ramp) / limits.velocity)
    return float(time.max(axis=1).min()) + _window(limits.acceleration, limits, dt)


def _window(strongest: Array, limits: Limits, dt: float) -> float:
    """Seconds over which to average: from full acceleration to the opposite within the jerk limits, and never at once."""
    return max(_SHORTEST * dt, float(np.max(2 * strongest / limits.jerk)))


def _gentler(limits: Limits, dt: float, deviation: float) -> float:
    """By how much to lower the acceleration so that averaging takes no joint further than `deviation` off the motion.

    In the middle of a window w the average of a motion differs from it by a w^2 / 24 at most, a being the largest
    acceleration: |x(t + s) - x(t) - v(t) s| <= a s^2 / 2, averaged over s from -w / 2 to w / 2.
    """
    most = 24 * deviation / float(np.max(limits.acceleration))
    return min(
        1.0, most / (_SHORTEST * dt) ** 2, math.cbrt(most / float(np.max(2 * limits.acceleration / limits.jerk)) ** 2)
    )
