"""Path -> motion that arrives soon: shortcuts in time at bounded acceleration, then bounded jerk.

A motion that stops at every corner of the path is made faster by replacing pieces of it with the fastest ramps between
their ends (`kernels.smoothing`). A moving average over time then turns steps of acceleration into slopes: an average of
values inside limits is inside them too, and jerk is at most twice the acceleration limit over the window (Biagiotti and
Melchiorri, "FIR filters for online trajectory planning with time- and frequency-domain specifications", 2012).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Self

import numpy as np

from zarm_planner.kernels.arrays import memory
from zarm_planner.kernels.ramps import Ramps, along, make_ramps
from zarm_planner.kernels.smoothing import smooth
from zarm_planner.motion import Array, Limits, Motion, sample_times, within
from zarm_planner.robot_model import RobotModel
from zarm_planner.stop import Stop
from zarm_planner.world import World

ATTEMPTS = 200
"""Shortcuts that are tried; five times as many gain 1 % more on MotionBenchMaker's problems."""
_ROOM = 256
"""Ramps of a motion at most, on top of one for each edge of the path."""


def smooth_path(
    model: RobotModel, world: World, path: Array, limits: Limits, dt: float, *, seed: int, stop: Stop
) -> Motion:
    """A fast motion from rest to rest from the first to the last row of `path` (n, dof), sampled every `dt` s or a little less.

    Where it leaves the path it is free of `world` in spheres, as straight edges between its configurations every
    `kernels.smoothing.STEP` s. The limits hold as `Motion.load` measures them. The same seed gives the same motion;
    `stop` only makes the search for a faster one end sooner.

    Raises InvalidRequest where the limits make the motion longer than `motion.MAX_SAMPLES`.
    """
    ramps = make_ramps(len(path) + _ROOM, model.dof)
    count = along(path, limits.velocity, limits.acceleration, ramps)
    if count == 0:
        return Motion.standing(path[0], dt)
    count = smooth(
        model.arrays,
        world.arrays,
        memory(model.arrays),
        ramps,
        count,
        np.stack((model.lower, model.upper, limits.velocity, limits.acceleration)),
        ATTEMPTS,
        np.array([seed], np.uint64),
        stop.deadline,
    )
    window = max(2 * dt, float(np.max(2 * limits.acceleration / limits.jerk)))
    return within(partial(_Smoothed.of(ramps, count, window).sample, dt=dt), limits)


@dataclass(frozen=True)
class _Smoothed:
    """A motion at stepwise constant acceleration, all of it averaged over `window` s, by which it lasts longer.

    Each joint's steps begin at the times `t`; there `area` is the integral over time of its position, and `acceleration`
    holds until the next: all (steps, dof). `end` (s) is where the last step ends.
    """

    t: Array
    area: Array
    position: Array
    velocity: Array
    acceleration: Array
    end: float
    window: float

    @classmethod
    def of(cls, ramps: Ramps, count: int, window: float) -> Self:
        """The first `count` ramps."""
        duration, x0, v0, a, first, last = (column[:count] for column in ramps)
        kept = np.maximum(duration[:, None] - first - last, 0.0)
        x1, v1 = x0 + first * (v0 + first * a / 2), v0 + first * a
        h, position, velocity, acceleration = (
            np.stack(phases, axis=1).reshape(3 * count, -1)
            for phases in (
                (first, kept, last),
                (x0, x1, x1 + kept * v1),
                (v0, v1, v1),
                (a, np.zeros_like(a), -a),
            )
        )
        area = h * (position + h * (velocity / 2 + h * acceleration / 6))
        t, area = (np.cumsum(steps, axis=0) - steps for steps in (h, area))
        return cls(t, area, position, velocity, acceleration, float(duration.sum()), window)

    def sample(self, factor: float, dt: float) -> Motion:
        """The motion at `factor` times its shortest duration, sampled every `dt` s or a little less."""
        t = sample_times(self.end + self.window, factor, dt)
        position, velocity, acceleration = (self._raw(t) - self._raw(t - self.window)) / self.window
        velocity[[0, -1]] = acceleration[[0, -1]] = 0.0
        return Motion(t * factor, position, velocity / factor, acceleration / factor**2)

    def _raw(self, t: Array) -> Array:
        """Before averaging: the integral over time of the position, the position and the velocity, (3, len(t), dof)."""
        inside = np.clip(t, 0.0, self.end)
        out = np.empty((3, len(t), self.t.shape[1]))
        for j in range(self.t.shape[1]):
            i = np.searchsorted(self.t[:, j], inside, side="right") - 1
            x, p, v, a = inside - self.t[i, j], self.position[i, j], self.velocity[i, j], self.acceleration[i, j]
            out[:, :, j] = self.area[i, j] + x * (p + x * (v / 2 + x * a / 6)), p + x * (v + x * a / 2), v + x * a
        out[0] += (t - inside)[:, None] * out[1]  # before and after, the robot rests
        return out
