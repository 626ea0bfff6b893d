"""Follows a chunk as nearly as the limits of a robot allow, planning anew whenever something changes."""

from __future__ import annotations

import numpy as np

from zarm_servo.kernels.step import PERIOD
from zarm_servo.tracking.receding_horizon import INTERVAL, MAX_INTERVALS, nearest_motion
from zarm_servo.tracking.reference import Reference
from zarm_trajectory.arrays import Array
from zarm_trajectory.limits import Limits

_STEPS = round(INTERVAL / PERIOD)


class ChunkFollower:
    """Steps inside `limits`, each to the state one PERIOD later; position limits are left to the check of each step."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._followed: tuple[Reference, float] | None = None
        self._jerks: Array = np.empty((0, 0))
        self._step = 0
        self._expected: Array = np.empty(0)  # the state after the last step; from another one a plan does not count

    def next(self, state: Array, reference: Reference, time: float, rate: float) -> Array | None:
        """The state (3, J) after `state`, which is meant for the `time` (s) of the reference, which passes at `rate` times that of the
        robot; None if no motion is found.
        """
        if not np.array_equal(state, self._expected):
            self._followed = None
        between = self._followed is None or self._step % _STEPS == 0  # intervals: there a plan keeps its limits exactly
        if between and (self._followed != (reference, rate) or self._step == _STEPS * len(self._jerks)):
            left = (reference.expires - time) / rate
            count = min(max(int(left / INTERVAL), 1), MAX_INTERVALS)
            wanted = reference.sample(time + rate * INTERVAL * np.arange(1.0, count + 1.0))[0]
            wanted = np.clip(wanted, self._limits.lower, self._limits.upper)
            jerks = nearest_motion(state, wanted, self._limits)
            if jerks is None:
                return None
            self._followed, self._jerks, self._step = (reference, rate), jerks, 0
        jerk = self._jerks[self._step // _STEPS]
        self._step += 1
        position, velocity, acceleration = state
        self._expected = np.stack(
            (
                position + PERIOD * (velocity + PERIOD * (acceleration / 2 + PERIOD * jerk / 6)),
                velocity + PERIOD * (acceleration + PERIOD * jerk / 2),
                acceleration + PERIOD * jerk,
            )
        )
        return self._expected
