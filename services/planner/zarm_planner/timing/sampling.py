"""Samples a trajectory, and slows it down until it keeps its limits."""

from __future__ import annotations

import math
from collections.abc import Callable

from zarm_contract.errors import InvalidRequest
from zarm_planner.kernels.quintic import peaks
from zarm_planner.kernels.sampling import subdivided
from zarm_trajectory.arrays import Array
from zarm_trajectory.limits import Limits
from zarm_trajectory.trajectory import TimedTrajectory

TOLERANCE = 2e-4
"""Share by which a motion may be too fast: velocity then exceeds its limit by at most this, acceleration by twice and
jerk by three times as much, all within 0.1 %.
"""
MAX_SAMPLES = 15_000
"""Longest motion in samples; for 7 joints just under the largest message (`zarm_contract.codec.MAX_BYTES`)."""


def sample_times(knots: Array, factor: float, dt: float) -> Array:
    """Times (n,) from the first to the last of the ascending `knots` (k,) in s, which are included; stretched by
    `factor` they are at most `dt` s apart.

    Raises InvalidRequest if these are more than MAX_SAMPLES.
    """
    times = subdivided(knots, factor, dt, MAX_SAMPLES)
    if len(times) == 0:
        raise InvalidRequest(
            f"the motion would last {(knots[-1] - knots[0]) * factor:.3g} s, and needs more than the {MAX_SAMPLES} samples "
            "that one message holds; raise velocity_scale and acceleration_scale",
            field="velocity_scale",
        )
    return times


def load(trajectory: TimedTrajectory, limits: Limits) -> float:
    """How far velocity, acceleration and jerk use their limits, 1 being fully, at any time, also between samples.

    Slowed down by this factor, the trajectory just meets all of them. NaN if it contains NaN.
    """
    velocity, acceleration, jerk = peaks(
        trajectory.time, trajectory.position, trajectory.velocity, trajectory.acceleration, limits.rates
    )
    return max(velocity, math.sqrt(acceleration), math.cbrt(jerk))


def within(sample: Callable[[float], TimedTrajectory], limits: Limits) -> TimedTrajectory:
    """A motion that can be sampled at any factor of its shortest duration, slowed down as much as the limits demand."""
    factor = 1.0
    for _ in range(8):  # usually one or two rounds; other sample times shift the extremes of the motion
        trajectory = sample(factor)
        used = load(trajectory, limits)
        if used <= 1 + TOLERANCE:
            return trajectory
        factor *= used
    return trajectory.slower(used)
