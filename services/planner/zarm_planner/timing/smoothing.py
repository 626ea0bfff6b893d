"""From a path to a fast trajectory: shortcuts in time at bounded acceleration, then bounded jerk.

A motion that stops at every corner of the path is made faster by replacing pieces of it with the fastest ramps between
their ends, straight or bent (`kernels.smoothing`). A moving average over time then turns steps of acceleration into
slopes: an average of values inside limits is inside them too, and jerk is at most twice the acceleration limit over the
window (Biagiotti and Melchiorri, "FIR filters for online trajectory planning with time- and frequency-domain
specifications", 2012).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from zarm_geometry.robot_model import RobotModel
from zarm_geometry.working_memory import working_memory
from zarm_geometry.world import World
from zarm_planner.deadline import Deadline
from zarm_planner.kernels import averaging as kernel
from zarm_planner.kernels.ramps import along, make_ramps, ramps_from
from zarm_planner.kernels.sampling import knots, sample_average
from zarm_planner.kernels.smoothing import smooth
from zarm_planner.timing.averaging import DEVIATION, MIN_AVERAGING_TIME, Averaging, total_ways
from zarm_planner.timing.lead_in import LeadIn
from zarm_planner.timing.sampling import TOLERANCE, load, sample_times, within
from zarm_trajectory.arrays import Array
from zarm_trajectory.limits import Limits
from zarm_trajectory.trajectory import TimedTrajectory

ATTEMPTS = 1500
"""Most shortcuts tried for a path, plus as many for each via; ten times as many gain 1 % on MotionBenchMaker's
problems.
"""
_PATIENCE = 384
"""Nearly useless shortcuts, plus as many for each via, after which no more are tried: this makes motions 0.1 % longer,
and the slowest twentieth takes two thirds of the time.
"""
_SPARE_ROWS = 256
"""Most ramps of a motion, in addition to one for each edge of the path."""
_MUCH = 0.5
"""A joint that uses less than this share of its speed and acceleration may overshoot between two samples, which saves
samples.
"""


class Smoothing:
    """The motion along a path, which becomes faster with more shortcuts."""

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
        lead_in: LeadIn | None = None,
    ) -> None:
        """As in `smooth_path`; the motion rests at each row of `path` until shortcuts are tried."""
        self._model, self._world, self._limits, self._dt, self._path = model, world, limits, dt, path
        self._lead_in = lead_in
        passed = np.zeros(len(path), np.bool_)
        passed[list(vias)] = True
        self._ramps = make_ramps(len(path) + _SPARE_ROWS, model.dof)
        if lead_in is None:
            used = Averaging.of(
                total_ways(path), limits.rates, MIN_AVERAGING_TIME * dt, deviation=deviation if len(vias) else np.inf
            )
            self._window, self._begin, past_count = used.window, 0.0, 0
            fastest, strongest = used.velocity, used.acceleration
        else:
            strongest, fastest, past_count = lead_in.strongest, lead_in.fastest, len(lead_in.ramps.duration)
            self._window = self._begin = lead_in.window
            for column, given in zip(self._ramps, lead_in.ramps, strict=True):
                column[:past_count] = given
        self._bounds = np.array((model.lower, model.upper, fastest, strongest))
        self._count = past_count + along(
            path, passed, np.minimum(fastest, limits.velocity), strongest, ramps_from(self._ramps, past_count)
        )
        self._stretches = 1 + len(vias)

    @property
    def duration(self) -> float:
        """The approximate duration (s) of the motion."""
        return float(self._ramps.duration[: self._count].sum()) + self._window - self._begin

    def shortcut(self, attempts: int, seed: int, deadline: Deadline) -> None:
        """Try this many shortcuts, plus as many for each via; stop early if they no longer help or at `deadline`."""
        if self._count == 0:  # the motion stays where it is
            return
        self._count = smooth(
            self._model.arrays,
            self._world.arrays,
            working_memory(self._model.arrays),
            self._ramps,
            self._count,
            self._bounds,
            self._begin,
            attempts * self._stretches,
            _PATIENCE * self._stretches,
            np.array([seed], np.uint64),
            deadline.at,
        )

    def trajectory(self) -> TimedTrajectory:
        """The present motion. Raises InvalidRequest if it is longer than `trajectory.MAX_SAMPLES`."""
        if self._count == 0:
            return TimedTrajectory.standing(self._path[0], self._dt)
        if self._lead_in is None:
            return within(self._sample, self._limits)
        # Slowing the motion down would change its start. More samples remove overshoot between them.
        trajectory = self._sample(1.0)
        return trajectory if load(trajectory, self._limits) <= 1 + TOLERANCE else self._sample(1.0, share=0.0)

    def _sample(self, factor: float, share: float = _MUCH) -> TimedTrajectory:
        """The motion at `factor` times its shortest duration, sampled at the knots of joints that use more than a
        `share` of their limits.
        """
        _, _, fastest, strongest = self._bounds
        times = knots(self._ramps, self._count, self._window, self._begin, share * fastest, share * strongest)
        t = sample_times(times, factor, self._dt)
        out = np.empty((3, len(t), self._model.dof))
        sample_average(self._ramps, self._count, self._window, t + self._begin, out)
        out[1:, -1] = 0.0
        if self._lead_in is None:
            out[1:, 0] = 0.0
        else:
            out[:, 0] = self._lead_in.state
        position, velocity, acceleration = out
        trajectory = TimedTrajectory(t, position, velocity, acceleration)
        return trajectory if factor == 1.0 else trajectory.slower(factor)


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
    lead_in: LeadIn | None = None,
) -> TimedTrajectory:
    """A fast motion from rest to rest from the first to the last row of `path` (n, dof), sampled every `dt` s, and
    additionally where a strong acceleration changes. With a `lead_in`, which leads to the first row, it begins in
    motion there.

    It passes the rows `vias` of the path in order, each joint within `deviation` (rad), and stops there only if no
    faster way is found to be free. Where it leaves the path it is free of `world` in spheres, with deviations from
    straight edges bounded by `kernels.smoothing.BOW`. The limits hold as `sampling.load` measures them. The same seed
    gives the same motion; `deadline` only makes the search for a faster one end sooner.

    Raises InvalidRequest if the limits make the motion longer than `trajectory.MAX_SAMPLES`.
    """
    smoothing = Smoothing(model, world, path, limits, dt, vias=vias, deviation=deviation, lead_in=lead_in)
    smoothing.shortcut(ATTEMPTS, seed, deadline)
    return smoothing.trajectory()


def brake_to_rest(model: RobotModel, world: World, lead_in: LeadIn, limits: Limits, dt: float) -> TimedTrajectory:
    """The motion of a lead-in alone."""
    return Smoothing(model, world, lead_in.rest[None], limits, dt, lead_in=lead_in).trajectory()


def least_duration(start: Array, goals: Array, limits: Limits, dt: float) -> float:
    """Lower bound (s) on the duration of `smooth_path` from `start` (dof,) to any of `goals` (n, dof), without
    obstacles.
    """
    return kernel.least_duration(start, goals, limits.rates, MIN_AVERAGING_TIME * dt)
