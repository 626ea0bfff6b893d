"""How joint positions that are told one after the other go on."""

from __future__ import annotations

from collections import deque

import numpy as np

from zarm_contract.robot import RobotDescription
from zarm_servo.tracking.targets import JointTarget
from zarm_trajectory.arrays import Array

_WINDOW = 0.12
"""Positions of the last so many s count."""
_MIN_POSITIONS = 4
"""Fewer positions say nothing about how they go on."""
_SMOOTH = 0.002, 0.05
"""Positions move steadily if they are this close (rad, share of how far they have moved) to a motion of constant acceleration."""

_JITTER = 0.005
"""Stamps are off by so much (s) where a program is held up between its position and its stamp."""
_ROUGH = 0.15
"""With a velocity at least, if they are this close (share) to one of constant velocity."""


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
            np.abs(position - self._samples[-1][1]) > (stamp - self._samples[-1][0] + _JITTER) * self._fastest
        ):
            self._samples.clear()
        self._samples.append((stamp, position))
        while self._samples[0][0] < stamp - _WINDOW:
            self._samples.popleft()
        if len(self._samples) < _MIN_POSITIONS:
            return JointTarget(position, np.zeros_like(position))
        times, positions = (
            np.array([time - stamp for time, _ in self._samples]),
            np.stack([each for _, each in self._samples]),
        )
        span = np.ptp(positions, axis=0)
        curved, off = _fitted(times, positions, 2)
        if np.all(off <= np.maximum(_SMOOTH[0], _SMOOTH[1] * span)):
            return JointTarget(curved[0], curved[1], 2 * curved[2])
        straight, off = _fitted(times, positions, 1)
        if np.all(off <= np.maximum(_SMOOTH[0], _ROUGH * span)):
            return JointTarget(position, straight[1])
        return JointTarget(position, np.zeros_like(position))


def _fitted(times: Array, positions: Array, degree: int) -> tuple[Array, Array]:
    """The polynomial through positions (N, J) at `times` (N,), lowest power first (degree + 1, J), and how far (J,) they are off it."""
    powers: Array = np.vander(times, degree + 1, increasing=True)
    found: Array = np.asarray(np.linalg.lstsq(powers, positions, rcond=None)[0], np.float64)
    return found, np.asarray(np.sqrt(((powers @ found - positions) ** 2).mean(axis=0)))
