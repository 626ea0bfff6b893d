"""Keeps a motion within the torques that its joints have."""

from __future__ import annotations

from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.dynamics import Dynamics
from zarm_planner.timing.pace import paced
from zarm_planner.timing.sampling import TOLERANCE, load, sample_times
from zarm_trajectory.limits import Limits
from zarm_trajectory.trajectory import TimedTrajectory

Array = NDArray[np.float64]

_COARSE = 0.025
"""A motion sampled at least this often (s) is looked at in its samples alone ..."""
_FAR = 0.8
"""... if it stays below this share of its limits there."""
_FINE = 0.003
"""Largest time (s) between two looks at others,"""
_VERIFIED = 0.0015
"""and at one that has been slowed down,"""
_LOOKS = 5000
"""unless there would be more."""
_SHARE = 0.994
"""Share of the largest torque that a motion may take: what is left is for rounding, and for what is between two looks."""
_SHARE_BEGUN = 0.95
"""The same where the motion has begun, and cannot be slowed down as a whole in the end."""
_SAME = 1e-9
"""Largest difference between two equal states."""
_SMALL = 1e-9
"""A torque (Nm) that counts as 0."""


class TooHeavy(Exception):
    """A `joint`, by number, cannot hold the robot, however slow the motion is; the message says when and by how much."""

    def __init__(self, joint: int, message: str) -> None:
        super().__init__(message)
        self.joint = joint


class TooFast(Exception):
    """A joint would need too much torque as `use` says, in a motion that cannot become slower and keep its start."""

    def __init__(self, use: TorqueUse) -> None:
        super().__init__(f"would need {use.share:.2f} of its effort at {use.time:.2f} s of a motion that has begun")
        self.use = use


class TorqueUse(NamedTuple):
    """The `joint`, by number, which comes nearest to its largest torque, the `share` of that, and when (s)."""

    joint: int
    share: float
    time: float


def within_torque(
    dynamics: Dynamics, motion: TimedTrajectory, limits: Limits, *, begun: bool = False
) -> tuple[TimedTrajectory, TorqueUse]:
    """The motion, slower where a joint would need more than its largest torque, and what it needs then. Its first columns are the joints of `limits`.

    One that has `begun` begins as it did. The limits hold as `sampling.load` measures them. Raises TooHeavy, TooFast, and
    InvalidRequest if the motion becomes longer than a message holds.
    """
    limit, joints = dynamics.limit, slice(len(limits.joints))
    if motion.steps.max() <= _COARSE:
        use = _largest(motion.time, dynamics.torque(*motion.states[:, :, joints]), limit)
        if use.share < _FAR:
            return motion, use
    looks = _Looks.at(dynamics, motion, joints, _FINE)
    use = _largest(looks.times, looks.torque, limit)
    if use.share <= _SHARE:
        return motion, use
    held = _largest(looks.times, looks.holding, limit)
    if held.share >= _SHARE:
        raise TooHeavy(
            held.joint,
            f"would need {held.share * limit[held.joint]:.0f} Nm to stand still at {held.time:.2f} s of the trajectory, and has "
            f"{limit[held.joint]:.0f}: the robot carries too much",
        )
    room = (_SHARE_BEGUN if begun else _SHARE) * limit
    position, velocity, _ = looks.states[:, :, joints]
    inert = dynamics.torque(position, np.zeros_like(velocity), velocity) - looks.holding
    needs = np.stack((looks.torque - looks.holding, inert, -room - looks.holding, room - looks.holding))
    slower = paced(motion, looks.times, looks.states, needs, limits)
    at_last = _Looks.at(dynamics, slower, joints, _VERIFIED)
    stretch = max(at_last.stretch(limit), load(slower.columns(joints), limits))
    if begun:
        if stretch > 1.0 + TOLERANCE or not np.allclose(
            slower.states[:, 0], motion.states[:, 0], rtol=_SAME, atol=_SAME
        ):
            raise TooFast(use)
        return slower, _largest(at_last.times, at_last.torque, limit)
    if slower.duration * stretch > motion.duration * looks.stretch(limit):
        slower, at_last, stretch = motion, looks, looks.stretch(limit)
    if stretch <= 1.0 + TOLERANCE:
        return slower, _largest(at_last.times, at_last.torque, limit)
    return slower.slower(stretch), _largest(stretch * at_last.times, at_last.slower(stretch), limit)


class _Looks(NamedTuple):
    """The `times` (n,) of a motion's samples, where the acceleration may have its peaks, and times between them; the
    `states` (3, n, columns) there, the `torque` (n, dof), and what of it holds the robot.
    """

    times: Array
    states: Array
    torque: Array
    holding: Array

    @classmethod
    def at(cls, dynamics: Dynamics, motion: TimedTrajectory, joints: slice, most: float) -> Self:
        """Looks at most about `most` s apart."""
        times = sample_times(motion.time, 1.0, max(most, motion.duration / _LOOKS))
        states = motion.sample(times)
        moving = states[:, :, joints]
        return cls(times, states, dynamics.torque(*moving), dynamics.holding(moving[0]))

    def slower(self, factor: float) -> Array:
        """The torque if the motion takes `factor` times as long: what speed and acceleration need falls with its square."""
        return np.asarray(self.holding + (self.torque - self.holding) / factor**2)

    def stretch(self, limit: Array) -> float:
        """How many times as long, at least once, the motion must take to keep the torques `limit` (dof,)."""
        moving = self.torque - self.holding
        room = np.maximum(_SHARE * limit - np.sign(moving) * self.holding, _SMALL)
        return max(1.0, float(np.sqrt((np.abs(moving) / room).max())))


def _largest(times: Array, torque: Array, limit: Array) -> TorqueUse:
    share = np.abs(torque) / limit
    sample, joint = np.unravel_index(share.argmax(), share.shape)
    return TorqueUse(int(joint), float(share[sample, joint]), float(times[sample]))
