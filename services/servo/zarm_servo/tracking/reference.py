"""The motion that a chunk of a client asks for: smooth through its points, and what of it the robot's limits do not allow."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from scipy.interpolate import CubicSpline

from zarm_contract.messages import Clipped
from zarm_trajectory.arrays import Array
from zarm_trajectory.limits import Limits
from zarm_trajectory.trajectory import TimedTrajectory

_CHECK_INTERVAL = 0.004
"""Interval (s) at which a motion is compared with the limits."""
_REPORTED_EXCESS = 1.001
"""Less than this factor over a limit is not told."""


@dataclass(frozen=True, eq=False)
class Reference:
    """The motion of a chunk on the servo's monotonic clock (s), which counts until `expires`. `openings` (N,), in m, are
    those of the `gripper` at the points.
    """

    motion: TimedTrajectory
    expires: float
    gripper: str | None = None
    openings: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def begins(self) -> float:
        """When it begins, s."""
        return self.motion.begin

    def sample(self, times: Array, rate: float = 1.0) -> Array:
        """Position, velocity and acceleration (3, K, J) at `times` (K,) s, as of a robot whose time passes at 1 / `rate` of that; at
        rest outside the chunk.
        """
        motion = self.motion
        states = motion.sample(np.clip(times, motion.begin, motion.duration))
        states[1] *= rate
        states[2] *= rate**2
        states[1:, (times < motion.begin) | (times > motion.duration)] = 0.0
        return states

    def opening(self, time: float) -> float:
        """The opening (m) of the gripper at a `time` (s)."""
        return float(np.interp(time, self.motion.time, self.openings))


def smooth(times: Array, positions: Array, velocities: Array | None = None) -> TimedTrajectory:
    """The motion through `positions` (N, J) at `times` (N,) with a continuous acceleration: a cubic spline or, with `velocities` (N, J),
    quintics whose accelerations are those of a spline through the velocities. The third derivative is continuous at the second and
    the last but one point (de Boor, "A Practical Guide to Splines", 1978).
    """
    if velocities is None:
        spline = CubicSpline(times, positions)
        return TimedTrajectory(times, positions, spline(times, 1), spline(times, 2))
    return TimedTrajectory(times, positions, velocities, CubicSpline(times, velocities)(times, 1))


def clipped(motion: TimedTrajectory, limits: Limits) -> tuple[Clipped, ...]:
    """By how much a motion asks more of each joint than its limits allow; the robot does as much as it can."""
    times = np.append(np.arange(motion.begin, motion.duration, _CHECK_INTERVAL), motion.duration)
    position, velocity, acceleration = motion.sample(times)
    out = np.maximum(position - limits.upper, limits.lower - position).max(axis=0)
    found = [
        Clipped(joint=joint, quantity="position", excess=by)
        for joint, by in zip(limits.joints, out.tolist(), strict=True)
        if by > 0
    ]
    asked: tuple[tuple[Literal["velocity", "acceleration", "jerk"], Array, Array], ...] = (
        ("velocity", velocity, limits.velocity),
        ("acceleration", acceleration, limits.acceleration),
        ("jerk", motion.jerks(times), limits.jerk),
    )
    for quantity, values, limit in asked:
        most = np.abs(values).max(axis=0)
        for joint, value, allowed in zip(limits.joints, most.tolist(), limit.tolist(), strict=True):
            if value > _REPORTED_EXCESS * allowed:
                found.append(Clipped(joint=joint, quantity=quantity, excess=value - allowed))
    return tuple(found)
