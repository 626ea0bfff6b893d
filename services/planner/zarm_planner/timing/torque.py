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
_FINE = 0.004
"""Time (s) between two looks at others."""
_SHARE = 0.997
"""Share of the largest torque that a motion may take: what is left is for rounding, and for what is between two looks."""


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


def within_torque(dynamics: Dynamics, motion: TimedTrajectory) -> tuple[float, TorqueUse]:
    """By how much a motion must be slowed down so that none of the first joints needs more than its largest torque, 1 if
    it need not be, and what it needs then. Raises TooHeavy.

    Slower by s, what speed and acceleration need falls with s²; what holds the robot stays.
    """
    limit = dynamics.limit
    if motion.steps.max() <= _COARSE:
        use = _largest(motion.time, dynamics.torque(*motion.states[:, :, : len(limit)]), limit)
        if use.share < _FAR:
            return 1.0, use
    times = _closely(motion)
    states = motion.sample(times)[:, :, : len(limit)]
    torque = dynamics.torque(*states)
    use = _largest(times, torque, limit)
    if use.share <= _SHARE:
        return 1.0, use
    holding = dynamics.holding(states[0])
    held = _largest(times, holding, limit)
    if held.share >= _SHARE:
        raise TooHeavy(
            held.joint,
            f"would need {held.share * limit[held.joint]:.0f} Nm to stand still at {held.time:.2f} s of the trajectory, and has "
            f"{limit[held.joint]:.0f}: the robot carries too much",
        )
    moving = torque - holding
    room = _SHARE * limit - np.sign(moving) * holding
    stretch = float(np.sqrt((np.abs(moving) / room).max()))
    return stretch, _largest(stretch * times, holding + moving / stretch**2, limit)


def _closely(motion: TimedTrajectory) -> Array:
    """The times of the samples, where the acceleration may have its peaks, and times between them."""
    parts = int(np.ceil(motion.steps.max() / _FINE))
    between = motion.time[:-1, None] + motion.steps[:, None] * np.arange(parts) / parts
    return np.append(between.ravel(), motion.duration)


def _largest(times: Array, torque: Array, limit: Array) -> TorqueUse:
    share = np.abs(torque) / limit
    sample, joint = np.unravel_index(share.argmax(), share.shape)
    return TorqueUse(int(joint), float(share[sample, joint]), float(times[sample]))
