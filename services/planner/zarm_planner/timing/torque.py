"""Keeps a motion within the torques that its joints have."""

from __future__ import annotations

from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.dynamics import Dynamics
from zarm_planner.timing.pace import paced
from zarm_planner.timing.sampling import TOLERANCE, load
from zarm_trajectory.arrays import Array
from zarm_trajectory.limits import Limits
from zarm_trajectory.trajectory import TimedTrajectory

_COARSE = 0.025
"""Between two samples that are no further apart (s) a motion is not looked at ..."""
_FAR = 0.8
"""... if it stays below this share of its limits in these."""
_MAX_CHECK_INTERVAL = 0.003
"""Largest time (s) between two looks where it does not,"""
_VERIFIED = 0.001
"""and there at one that has been slowed down,"""
_MAX_CHECKS = 5000
"""unless there would be more."""
_GRID = 0.006
"""Largest time (s) between two points at which the pace of a motion is found."""
_TORQUE_SHARE = 0.993
"""Share of the largest torque that a motion may take: what is left is for rounding, and for what is between two looks."""
_SHARE_BEGUN = 0.95
"""The same where the motion has begun, and cannot be slowed down as a whole in the end."""
_STATE_TOLERANCE = 1e-9
"""Largest difference between two equal states."""
_SMALL = 1e-9
"""A torque (Nm) that counts as 0."""
_SLOW = 1e-9
"""The share of a motion's velocity at which it counts as slow as can be: there is no damping, but there is friction."""


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
    looks = _Looks.at(dynamics, motion, joints, _MAX_CHECK_INTERVAL, _GRID)
    use = looks.largest(limit)
    if use.share <= _TORQUE_SHARE:
        return motion, use
    position, velocity, _ = looks.states[:, :, joints]
    holding = dynamics.holding(position)
    slowest = _largest(looks.times, holding + dynamics.resistance(_SLOW * velocity), limit)
    if slowest.share >= _TORQUE_SHARE:
        raise TooHeavy(
            slowest.joint,
            f"would need {slowest.share * limit[slowest.joint]:.0f} Nm at {slowest.time:.2f} s of the trajectory, however slow it is, and has "
            f"{limit[slowest.joint]:.0f}: the robot carries too much",
        )
    steady = holding + dynamics.resistance(velocity)
    room = (_SHARE_BEGUN if begun else _TORQUE_SHARE) * limit
    inert = dynamics.torque(position, np.zeros_like(velocity), velocity) - holding
    least, most = np.minimum(-room - steady, -_SMALL), np.maximum(room - steady, _SMALL)
    needs = np.stack((looks.torque - steady, inert, least, most))
    slower = paced(motion, looks.times, looks.states, needs, limits)
    at_last = _Looks.at(dynamics, slower, joints, _VERIFIED)
    stretch = max(at_last.stretch(dynamics), load(slower.columns(joints), limits))
    if begun:
        if stretch > 1.0 + TOLERANCE or not np.allclose(
            slower.states[:, 0], motion.states[:, 0], rtol=_STATE_TOLERANCE, atol=_STATE_TOLERANCE
        ):
            raise TooFast(use)
        return slower, at_last.largest(limit)
    whole = looks.stretch(dynamics)
    if slower.duration * stretch > motion.duration * whole:
        slower, at_last, stretch = motion, looks, whole
    if stretch <= 1.0 + TOLERANCE:
        return slower, at_last.largest(limit)
    return slower.slower(stretch), _largest(stretch * at_last.times, at_last.slower(stretch, dynamics), limit)


class _Looks(NamedTuple):
    """The `times` (n,) of a motion's samples, where the acceleration may have its peaks, and times between them where a joint may come near
    to its largest torque; the `states` (3, n, columns) there, those of the `joints` first, and the `torque` (n, dof).
    """

    times: Array
    states: Array
    joints: slice
    torque: Array

    @classmethod
    def at(cls, dynamics: Dynamics, motion: TimedTrajectory, joints: slice, near: float, far: float = np.inf) -> Self:
        """Looks at most about `near` s apart where a joint may come near to its largest torque, and `far` s elsewhere."""
        torque = dynamics.torque(*motion.states[:, :, joints])
        close = _near(motion, torque, dynamics.limit)
        if not close.any():
            return cls(motion.time, motion.states, joints, torque)
        times = _between(motion, np.maximum(np.where(close, near, far), motion.duration / _MAX_CHECKS))
        states = motion.sample(times)
        return cls(times, states, joints, dynamics.torque(*states[:, :, joints]))

    def steady(self, dynamics: Dynamics) -> Array:
        """What of the torque (n, dof) does not fall with the square of the speed."""
        position, velocity, _ = self.states[:, :, self.joints]
        return dynamics.holding(position) + dynamics.resistance(velocity)

    def largest(self, limit: Array) -> TorqueUse:
        """The use of the largest torques `limit` (dof,)."""
        return _largest(self.times, self.torque, limit)

    def slower(self, factor: float, dynamics: Dynamics) -> Array:
        """The torque if the motion takes `factor` times as long, at most: what is not steady falls with its square."""
        steady = self.steady(dynamics)
        return np.asarray(steady + (self.torque - steady) / factor**2)

    def stretch(self, dynamics: Dynamics) -> float:
        """How many times as long, at least once, the motion must take to keep the largest torques."""
        over = (np.abs(self.torque) > _TORQUE_SHARE * dynamics.limit).any(axis=1)
        if not over.any():
            return 1.0
        position, velocity, _ = self.states[:, over][:, :, self.joints]
        steady = dynamics.holding(position) + dynamics.resistance(velocity)
        moving = self.torque[over] - steady
        room = np.maximum(_TORQUE_SHARE * dynamics.limit - np.sign(moving) * steady, _SMALL)
        return max(1.0, float(np.sqrt((np.abs(moving) / room).max())))


def _near(motion: TimedTrajectory, torque: Array, limit: Array) -> NDArray[np.bool_]:
    """Between which samples (n - 1,) of a motion a joint may need its largest torque, which needs `torque` (n, dof) in them."""
    near: NDArray[np.bool_] = (np.abs(torque) / limit).max(axis=1) >= _FAR
    return near[:-1] | near[1:] | (motion.steps > _COARSE)


def _between(motion: TimedTrajectory, most: Array) -> Array:
    """The times (n,) of the samples of a motion, and more, so that they are at most `most` (k - 1,) s apart in each interval."""
    counts = np.maximum(np.ceil(motion.steps / most), 1.0).astype(int)
    first = np.repeat(np.cumsum(counts) - counts, counts)
    shares = (np.arange(len(first)) - first) / np.repeat(counts, counts)
    times = np.repeat(motion.time[:-1], counts) + shares * np.repeat(motion.steps, counts)
    return np.append(times, motion.time[-1])


def _largest(times: Array, torque: Array, limit: Array) -> TorqueUse:
    share = np.abs(torque) / limit
    sample, joint = np.unravel_index(share.argmax(), share.shape)
    return TorqueUse(int(joint), float(share[sample, joint]), float(times[sample]))
