"""What timing promises: along the path, inside the limits everywhere, from rest to rest, never absurdly slow."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from support.examples import examples
from support.jerk import greatest_jerk
from support.planner.limits import joint_limits
from zarm_contract.errors import InvalidRequest
from zarm_planner.timing.sampling import load
from zarm_planner.timing.time_parameterization import time_path
from zarm_trajectory.arrays import Array
from zarm_trajectory.trajectory import TimedTrajectory

DT = 0.01
LIMITS = joint_limits(np.array([2.0, 1.0, 3.0]), np.array([1.0, 2.0, 5.0]), np.array([500.0, 100.0, 50.0]))

waypoints = arrays(np.float64, st.tuples(st.integers(2, 7), st.just(3)), elements=st.floats(-3, 3, width=32))
scales = st.sampled_from([1e-4, 1e-2, 1.0, 2.0])
deviations = st.sampled_from([0.2, 0.05, 0.01, 0.001, 0.0])


def between(motion: TimedTrajectory, order: int, fractions: Array) -> Array:
    """The motion's derivative of an order at fractions (k,) of each interval, (n - 1, k, dof): from the six conditions
    that a quintic meets, solved afresh.
    """
    h = np.diff(motion.time)
    powers = np.arange(6)

    def derivative(order: int, t: Array) -> Array:
        factors = np.array([math.perm(k, order) for k in range(6)])
        exponents = np.maximum(powers - order, 0)
        return factors * t[..., None] ** exponents

    ends = np.stack([np.zeros_like(h), h], axis=1)
    conditions = np.concatenate([derivative(k, ends) for k in range(3)], axis=1)
    rows = [np.stack([m[:-1], m[1:]], axis=1) for m in (motion.position, motion.velocity, motion.acceleration)]
    coefficients = np.linalg.solve(conditions, np.concatenate(rows, axis=1))
    values: Array = derivative(order, h[:, None] * fractions) @ coefficients
    return values


def distance_to(path: Array, points: Array) -> float:
    """How far the farthest of the points is from the polyline."""
    best = np.full(len(points), np.inf)
    for a, b in itertools.pairwise(path):
        edge = b - a
        x = np.clip((points - a) @ edge / max(float(edge @ edge), 1e-300), 0.0, 1.0)
        best = np.minimum(best, np.linalg.norm(points - a - x[:, None] * edge, axis=1))
    return float(best.max())


@examples(0.25)
@given(waypoints, scales, deviations)
def test_velocity_and_acceleration_hold_between_samples_too(points: Array, scale: float, deviation: float) -> None:
    motion = time_path(points * scale, LIMITS, DT, deviation)
    fractions = np.linspace(0.0, 1.0, 41)
    assert np.all(np.abs(between(motion, 1, fractions)) <= LIMITS.velocity * 1.002)
    assert np.all(np.abs(between(motion, 2, fractions)) <= LIMITS.acceleration * 1.005)


@pytest.mark.lengthy
@examples(0.25)
@given(waypoints, scales, deviations)
def test_jerk_holds_between_samples_too(points: Array, scale: float, deviation: float) -> None:
    motion = time_path(points * scale, LIMITS, DT, deviation)
    assert np.all(greatest_jerk(motion) <= LIMITS.jerk * 1.005)


@examples(0.25)
@given(waypoints, scales, deviations)
@example(np.array([[0.0, 0, 0], [1, 1, 1], [0, 0, 0]]), 1.0, 0.05)  # there and straight back
@example(np.array([[0.0, 0, 0], [1, 0, 0], [1, 0, 0], [2, 0, 0]]), 1.0, 0.05)  # a waypoint twice
def test_the_motion_is_from_rest_to_rest_between_its_ends(points: Array, scale: float, deviation: float) -> None:
    path = points * scale
    motion = time_path(path, LIMITS, DT, deviation)
    assert np.allclose(motion.position[[0, -1]], path[[0, -1]], atol=1e-8)
    assert not motion.velocity[[0, -1]].any()
    assert motion.time[0] == 0.0
    assert np.all(np.diff(motion.time) > 0.0)
    assert np.all(np.diff(motion.time) <= DT * (1 + 1e-6))


@examples(0.25)
@given(waypoints, scales, deviations)
def test_the_motion_leaves_the_path_by_at_most_the_deviation(points: Array, scale: float, deviation: float) -> None:
    path = points * scale
    motion = time_path(path, LIMITS, DT, deviation)
    positions, _, _ = motion.sample(np.linspace(0.0, motion.duration, 2000))
    assert distance_to(path, positions) <= deviation + 1e-4 * LIMITS.velocity.max()


@examples(0.25)
@given(waypoints, deviations)
def test_rounding_corners_is_never_slower_than_stopping_at_them(points: Array, deviation: float) -> None:
    assume(np.linalg.norm(np.diff(points, axis=0), axis=1).min() > 1e-3)
    stopping = time_path(points, LIMITS, DT, 0.0)
    assert time_path(points, LIMITS, DT, deviation).duration <= stopping.duration * 1.02


def test_one_edge_takes_the_shortest_time_that_its_limits_allow() -> None:
    motion = time_path(np.array([[0.0, 0, 0], [4.0, 0, 0]]), LIMITS, DT, 0.1)
    shortest = 4.0 / 2.0 + 2.0 / 1.0  # at full speed, and what speeding up and slowing down cost
    assert shortest < motion.duration < 1.05 * shortest


def test_a_corner_of_next_to_no_size_is_stopped_at() -> None:
    tiny = 2.0**-24
    path = np.array([[3.0, tiny, tiny], [tiny, tiny, 0.0], [tiny, tiny, tiny], [1.0, tiny, tiny]])
    assert time_path(path, LIMITS, DT, 0.2).duration <= time_path(path, LIMITS, DT, 0.0).duration


def test_a_wider_rounding_is_faster() -> None:
    path = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [2, 1, 0]])
    durations = [time_path(path, LIMITS, DT, deviation).duration for deviation in (0.1, 0.03, 0.01, 0.0)]
    assert durations == sorted(durations)


@pytest.mark.parametrize("corner", [[0.0, 0, 0], [1.0, 1, 0]])
def test_a_motion_too_slow_for_one_message_is_refused(corner: list[float]) -> None:
    path = np.array([[0.0, 0, 0], corner, [1, 0, 1]])
    slow = joint_limits(LIMITS.velocity * 1e-6, LIMITS.acceleration * 1e-6, LIMITS.jerk)
    with pytest.raises(InvalidRequest, match="raise velocity_scale"):
        time_path(path, slow, DT, 0.1)


def test_no_distance_at_all_gives_a_motion_that_stands_still() -> None:
    motion = time_path(np.full((3, 3), 0.7), LIMITS, DT, 0.1)
    assert len(motion.time) == 2
    assert np.all(motion.position == 0.7)
    assert not motion.velocity.any()


@pytest.mark.parametrize("factor", [0.5, 3.0])
def test_load_is_the_slowdown_that_keeps_the_limits(factor: float) -> None:
    motion = time_path(np.array([[0.0, 0, 0], [1, 2, 0], [3, 0, 1]]), LIMITS, DT, 0.05)
    other = motion.slower(factor)
    assert load(other.slower(load(other, LIMITS)), LIMITS) == pytest.approx(1.0, abs=1e-6)


def test_between_samples_a_motion_is_the_quintic_of_the_contract() -> None:
    motion = time_path(np.array([[0.0, 0, 0], [1, 2, 0], [3, 0, 1]]), LIMITS, 0.1, 0.05)
    h = np.diff(motion.time)
    for order, rows in enumerate(motion.sample(motion.time[:-1] + 0.3 * h)):
        assert np.allclose(rows, between(motion, order, np.array([0.3]))[:, 0], atol=1e-8)
