"""Slows a motion down to the torques that its joints have."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.dynamics import Dynamics
from zarm_trajectory.trajectory import TimedTrajectory

Array = NDArray[np.float64]

_COARSE = 0.025
"""A motion sampled at least this often (s) is looked at in its samples alone ..."""
_FAR = 0.8
"""... if it stays below this share of its limits there."""
_FINE = 0.001
"""Time (s) between two looks at others."""
_SHARE = 0.998
"""Share of the largest torque that a motion takes which has to be slowed down: what is left is for rounding."""


class TooHeavy(Exception):
    """A `joint`, by number, cannot hold the robot, however slow the motion is; the message says when and by how much."""

    def __init__(self, joint: int, message: str) -> None:
        super().__init__(message)
        self.joint = joint


class TorqueUse(NamedTuple):
    """The `joint`, by number, which comes nearest to its largest torque, the `share` of that, and when (s)."""

    joint: int
    share: float
    time: float


def torque_use(dynamics: Dynamics, motion: TimedTrajectory) -> TorqueUse:
    """How much of the largest torques a motion of the first joints takes."""
    if motion.steps.max() <= _COARSE:
        use = _use(dynamics, motion.time, motion.states[:, :, : len(dynamics.limit)])
        if use.share < _FAR:
            return use
    return _use(dynamics, *_sampled(dynamics, motion, _FINE))


def stretch_for_torque(dynamics: Dynamics, motion: TimedTrajectory) -> float:
    """By how much a motion must be slowed down so that no joint needs more than its largest torque. Raises TooHeavy.

    Slower by s, what speed and acceleration need falls with s²; what holds the robot stays.
    """
    times, states = _sampled(dynamics, motion, _FINE)
    holding = dynamics.holding(states[0])
    share = np.abs(holding) / dynamics.limit
    if share.max() >= _SHARE:
        sample, joint = np.unravel_index(share.argmax(), share.shape)
        raise TooHeavy(
            int(joint),
            f"would need {abs(holding[sample, joint]):.0f} Nm to stand still at {times[sample]:.2f} s of the trajectory, and has "
            f"{dynamics.limit[joint]:.0f}",
        )
    moving = dynamics.torque(*states) - holding
    room = _SHARE * dynamics.limit - np.sign(moving) * holding
    return float(np.sqrt(max(1.0, (np.abs(moving) / room).max())))


def _sampled(dynamics: Dynamics, motion: TimedTrajectory, step: float) -> tuple[Array, Array]:
    """Times (n,), and position, velocity and acceleration (3, n, dof) at them."""
    count = max(2, int(np.ceil((motion.duration - motion.begin) / step)) + 1)
    times = np.linspace(motion.begin, motion.duration, count)
    return times, motion.sample(times)[:, :, : len(dynamics.limit)]


def _use(dynamics: Dynamics, times: Array, states: Array) -> TorqueUse:
    share = np.abs(dynamics.torque(*states)) / dynamics.limit
    sample, joint = np.unravel_index(share.argmax(), share.shape)
    return TorqueUse(int(joint), float(share[sample, joint]), float(times[sample]))
