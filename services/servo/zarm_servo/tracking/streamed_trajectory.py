"""The stream of a session: the steps since the last chunk, and the braking after them."""

from __future__ import annotations

import numpy as np

from zarm_servo.kernels.step import PERIOD
from zarm_servo.tracking.controller import Step
from zarm_servo.tracking.speed_change import SpeedChange
from zarm_trajectory.arrays import Array
from zarm_trajectory.trajectory import TimedTrajectory

REST = 0.5
"""Time at rest (s) that ends a chunk: at its end the stream's time stands still."""
_MIN_INTERVAL = 1e-5
"""Least time (s) between samples."""


class StreamedTrajectory:
    """Begins in `state` (3, J) at the stream time `start` (s); `braking` leads from there to rest."""

    def __init__(self, start: float, state: Array, braking: SpeedChange) -> None:
        self._begun, self._steps = start, 0
        self._states = [state]
        self._braking, self._braked = braking, 0.0

    @property
    def time(self) -> float:
        """The stream time (s) up to which there are steps."""
        return self._begun + (self._steps + self.pending) * PERIOD

    @property
    def pending(self) -> int:
        """The number of steps not yet in any chunk."""
        return len(self._states) - 1

    def add(self, step: Step) -> None:
        """Append a step."""
        self._states.append(step.state)
        self._braking, self._braked = step.braking, step.braked

    def chunk(self) -> tuple[float, TimedTrajectory]:
        """The stream time (s) at which the next chunk starts, and its trajectory to rest. It begins exactly where the
        steps of the previous chunk ended.
        """
        start, times = self._begun + self._steps * PERIOD, PERIOD * np.arange(len(self._states))
        knots = self._braking.knots
        knots = knots[knots > self._braked + _MIN_INTERVAL]
        if len(knots):  # of two close ones the later stays: the last is exactly at rest
            knots = knots[np.append(np.diff(knots) > _MIN_INTERVAL, True)]
        states = np.concatenate((np.stack(self._states, axis=1), self._braking.sample(knots)), axis=1)
        rest = states[:, -1:].copy()
        rest[1:] = 0.0
        times = np.concatenate((times, times[-1] + knots - self._braked))
        self._steps += self.pending
        self._states = self._states[-1:]
        return start, TimedTrajectory(np.append(times, times[-1] + REST), *np.concatenate((states, rest), axis=1))
