"""How joint positions that are told one after the other go on."""

from __future__ import annotations

from collections import deque

import numpy as np

from zarm_contract.robot import RobotDescription
from zarm_servo.tracking.targets import JointTarget
from zarm_trajectory.quintic import Array

_WINDOW = 0.12
"""Positions of the last so many s count."""
_LEAST = 4
"""Fewer positions say nothing about how they go on."""
_SMOOTH = 0.002, 0.05
"""Positions move steadily if they are this close (rad, share of how far they have moved) to a motion of constant acceleration."""


class JointStream:
    """The last positions of a stream for a robot."""

    def __init__(self, robot: RobotDescription) -> None:
        self._fastest = np.array(robot.descriptor.cspace.velocity)
        self._samples: deque[tuple[float, Array]] = deque()

    def clear(self) -> None:
        """Forget all positions."""
        self._samples.clear()

    def moving(self, stamp: float, position: Array) -> JointTarget:
        """The target at the newest `position` (J,), told at `stamp` (s), which goes on as the ones before; it stands where these do not move
        steadily, or faster than the robot can.
        """
        if self._samples and np.any(
            np.abs(position - self._samples[-1][1]) > (stamp - self._samples[-1][0]) * self._fastest
        ):
            self._samples.clear()
        self._samples.append((stamp, position))
        while self._samples[0][0] < stamp - _WINDOW:
            self._samples.popleft()
        if len(self._samples) < _LEAST:
            return JointTarget(position, np.zeros_like(position))
        times, positions = (
            np.array([time - stamp for time, _ in self._samples]),
            np.stack([each for _, each in self._samples]),
        )
        powers = np.vander(times, 3, increasing=True)
        fitted, *_ = np.linalg.lstsq(powers, positions, rcond=None)
        off = np.sqrt(((powers @ fitted - positions) ** 2).mean(axis=0))
        if np.any(off > np.maximum(_SMOOTH[0], _SMOOTH[1] * np.ptp(positions, axis=0))):
            return JointTarget(position, np.zeros_like(position))
        return JointTarget(fitted[0], fitted[1], 2 * fitted[2])
