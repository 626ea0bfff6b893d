"""What timing along a path promises: as fast as TOPPRA by its authors, within the same limits."""

from __future__ import annotations

import logging

import numpy as np
import pytest
from toppra.algorithm import TOPPRA
from toppra.constraint import JointAccelerationConstraint, JointVelocityConstraint

from support.planner.limits import joint_limits
from zarm_planner.timing.averaging import Averaging, total_ways
from zarm_planner.timing.time_parameterization import Profile, fastest_along, round_corners, through
from zarm_trajectory.arrays import Array
from zarm_trajectory.trajectory import TimedTrajectory

DT = 0.01
POINTS = 200


def drawn(number: int) -> tuple[TimedTrajectory, Array]:
    """A curve, and limits (3, dof) of velocity, acceleration and jerk."""
    rng = np.random.default_rng(number)
    dof = int(rng.integers(2, 9))
    points = rng.normal(size=(rng.integers(3, 20), dof)) * 10.0 ** rng.uniform(-2.0, 0.5)
    curve = through(points) if number % 2 else round_corners(points, 10.0 ** rng.uniform(-3.0, -0.5))
    return curve, 10.0 ** rng.uniform(((-1.0,), (-1.0,), (0.0,)), ((1.0,), (1.5,), (2.5,)), (3, dof))


def timed(number: int) -> tuple[Profile, Array]:
    curve, rates = drawn(number)
    profile = fastest_along(curve, joint_limits(*rates), DT, curve.duration / POINTS)
    assert profile is not None
    return profile, rates


class Path:
    """A curve in TOPPRA's interface."""

    def __init__(self, curve: TimedTrajectory) -> None:
        self.curve = curve
        self.dof = curve.position.shape[1]
        self.path_interval = curve.time[[0, -1]]

    def __call__(self, s: Array, order: int = 0) -> Array:
        return np.asarray(self.curve.sample(s)[order])


@pytest.mark.parametrize("number", range(40))
def test_a_motion_takes_no_longer_than_by_toppra(number: int) -> None:
    profile, rates = timed(number)
    logging.getLogger("toppra").setLevel(logging.CRITICAL)
    used = Averaging.of(total_ways(profile.curve.position), rates, 2.0 * DT)
    reference = TOPPRA(
        [JointVelocityConstraint(used.velocity), JointAccelerationConstraint(used.acceleration)],
        Path(profile.curve),
        gridpoints=profile.s,
        solver_wrapper="seidel",
    )
    reference.compute_parameterization(0.0, 0.0)
    speed = reference.problem_data.sd_vec
    duration = float((2.0 * np.diff(profile.s) / (speed[1:] + speed[:-1])).sum())
    assert profile.t[-1] <= 1.001 * duration


@pytest.mark.parametrize("number", range(40))
def test_no_joint_exceeds_its_velocity_or_acceleration(number: int) -> None:
    """At both ends of each interval, in which the acceleration along the curve is constant."""
    profile, rates = timed(number)
    _, slope, bend = profile.curve.sample(profile.s)
    square = profile.sd[:, None] ** 2
    along = np.diff(square, axis=0) / (2.0 * np.diff(profile.s)[:, None])
    assert (np.abs(slope) * profile.sd[:, None] <= rates[0] * (1.0 + 1e-9)).all()
    for here in (slice(None, -1), slice(1, None)):
        acceleration = bend[here] * square[here] + slope[here] * along
        assert (np.abs(acceleration) <= rates[1] * (1.0 + 1e-6) + 1e-9).all()


def test_a_motion_uses_a_limit_almost_everywhere() -> None:
    """A faster one would exceed it; in an interval in which another limit takes over none may be used fully."""
    profile, rates = timed(1)
    _, slope, bend = profile.curve.sample(profile.s)
    used = Averaging.of(total_ways(profile.curve.position), rates, 2.0 * DT)
    square = profile.sd[:, None] ** 2
    along = np.diff(square, axis=0) / (2.0 * np.diff(profile.s)[:, None])
    fast = (np.abs(slope) * profile.sd[:, None] / used.velocity).max(axis=1)
    strong = [
        (np.abs(bend[here] * square[here] + slope[here] * along) / used.acceleration).max(axis=1)
        for here in (slice(None, -1), slice(1, None))
    ]
    share = np.maximum(np.maximum(fast[:-1], fast[1:]), np.maximum(*strong))
    assert (share > 0.99).mean() > 0.95
