"""What timing promises: along the path, inside the limits everywhere, from rest to rest, never absurdly slow."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from zarm_planner.motion import Limits, Motion
from zarm_planner.timing import time_path

Array = NDArray[np.float64]

DT = 0.01
LIMITS = Limits(np.array([2.0, 1.0, 3.0]), np.array([1.0, 2.0, 5.0]), np.array([500.0, 100.0, 50.0]))

waypoints = arrays(np.float64, st.tuples(st.integers(2, 7), st.just(3)), elements=st.floats(-3, 3, width=32))
scales = st.sampled_from([1e-4, 1e-2, 1.0, 2.0])
deviations = st.sampled_from([0.2, 0.05, 0.01, 0.001, 0.0])


def quintics(motion: Motion) -> list[list[Polynomial]]:
    """For each interval and joint the polynomial in time that meets position, velocity and acceleration at both ends."""
    intervals = []
    for i, h in enumerate(np.diff(motion.time)):
        powers = [Polynomial.basis(k) for k in range(6)]
        rows = [[power.deriv(order)(x) if order else power(x) for power in powers] for order in range(3) for x in (0.0, h)]
        ends = np.stack([m[i : i + 2] for m in (motion.position, motion.velocity, motion.acceleration)]).reshape(6, -1)
        intervals.append([Polynomial(c) for c in np.linalg.solve(rows, ends).T])
    return intervals


def peak(polynomial: Polynomial, h: float) -> float:
    """The largest absolute value on 0..h."""
    turns = polynomial.deriv().roots()
    inside = [x.real for x in turns if abs(x.imag) < 1e-9 and 0 < x.real < h]
    return float(max(abs(polynomial(x)) for x in (0.0, h, *inside)))


def distance_to(path: Array, points: Array) -> float:
    """How far the farthest of the points is from the polyline."""
    best = np.full(len(points), np.inf)
    for a, b in itertools.pairwise(path):
        edge = b - a
        x = np.clip((points - a) @ edge / max(float(edge @ edge), 1e-300), 0.0, 1.0)
        best = np.minimum(best, np.linalg.norm(points - a - x[:, None] * edge, axis=1))
    return float(best.max())


@settings(max_examples=12, deadline=None)
@given(waypoints, scales, deviations)
def test_velocity_and_acceleration_hold_between_samples_too(points: Array, scale: float, deviation: float) -> None:
    motion = time_path(points * scale, LIMITS, DT, deviation)
    for h, joints in zip(np.diff(motion.time), quintics(motion), strict=True):
        for joint, curve in enumerate(joints):
            assert peak(curve.deriv(), h) <= LIMITS.velocity[joint] * 1.002
            assert peak(curve.deriv(2), h) <= LIMITS.acceleration[joint] * 1.005


@settings(max_examples=25, deadline=None)
@given(waypoints, scales, deviations)
def test_acceleration_changes_no_faster_from_sample_to_sample_than_the_jerk_limit(
    points: Array, scale: float, deviation: float
) -> None:
    motion = time_path(points * scale, LIMITS, DT, deviation)
    jerk = np.abs(np.diff(motion.acceleration, axis=0)) / np.diff(motion.time)[:, None]
    assert np.all(jerk <= LIMITS.jerk * 1.005)


@settings(max_examples=25, deadline=None)
@given(waypoints, scales, deviations)
@example(np.array([[0.0, 0, 0], [1, 1, 1], [0, 0, 0]]), 1.0, 0.05)  # there and straight back
@example(np.array([[0.0, 0, 0], [1, 0, 0], [1, 0, 0], [2, 0, 0]]), 1.0, 0.05)  # a waypoint twice
def test_the_motion_leads_from_the_first_to_the_last_point_from_rest_to_rest(
    points: Array, scale: float, deviation: float
) -> None:
    path = points * scale
    motion = time_path(path, LIMITS, DT, deviation)
    assert np.allclose(motion.position[[0, -1]], path[[0, -1]], atol=1e-8)
    assert not motion.velocity[[0, -1]].any()
    assert motion.time[0] == 0.0
    assert np.all(np.diff(motion.time) > 0.0)
    assert np.all(np.diff(motion.time) <= DT * (1 + 1e-6))


@settings(max_examples=25, deadline=None)
@given(waypoints, scales, deviations)
def test_the_motion_leaves_the_path_by_no_more_than_the_deviation(points: Array, scale: float, deviation: float) -> None:
    path = points * scale
    motion = time_path(path, LIMITS, DT, deviation)
    positions, _, _ = motion.at(np.linspace(0.0, motion.duration, 2000))
    assert distance_to(path, positions) <= deviation + 1e-4 * LIMITS.velocity.max()


@settings(max_examples=12, deadline=None)
@given(waypoints, deviations)
def test_rounding_corners_is_never_slower_than_stopping_at_them(points: Array, deviation: float) -> None:
    assume(np.linalg.norm(np.diff(points, axis=0), axis=1).min() > 1e-3)
    stopping = time_path(points, LIMITS, DT, 0.0)
    assert time_path(points, LIMITS, DT, deviation).duration <= stopping.duration * 1.02


def test_one_edge_takes_the_shortest_time_that_its_limits_allow() -> None:
    motion = time_path(np.array([[0.0, 0, 0], [4.0, 0, 0]]), LIMITS, DT, 0.1)
    shortest = 4.0 / 2.0 + 2.0 / 1.0  # at full speed, and what speeding up and slowing down cost
    assert shortest < motion.duration < 1.05 * shortest


def test_a_wider_rounding_is_faster() -> None:
    path = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [2, 1, 0]])
    durations = [time_path(path, LIMITS, DT, deviation).duration for deviation in (0.1, 0.03, 0.01, 0.0)]
    assert durations == sorted(durations)


def test_no_distance_at_all_gives_a_motion_that_stands_still() -> None:
    motion = time_path(np.full((3, 3), 0.7), LIMITS, DT, 0.1)
    assert len(motion.time) == 2
    assert np.all(motion.position == 0.7)
    assert not motion.velocity.any()


@pytest.mark.parametrize("factor", [0.5, 3.0])
def test_load_is_the_factor_by_which_slower_running_keeps_the_limits(factor: float) -> None:
    motion = time_path(np.array([[0.0, 0, 0], [1, 2, 0], [3, 0, 1]]), LIMITS, DT, 0.05)
    other = motion.slower(factor)
    assert other.slower(other.load(LIMITS)).load(LIMITS) == pytest.approx(1.0, abs=1e-6)


def test_between_samples_a_motion_is_the_quintic_of_the_contract() -> None:
    motion = time_path(np.array([[0.0, 0, 0], [1, 2, 0], [3, 0, 1]]), LIMITS, 0.1, 0.05)
    for i, curves in enumerate(quintics(motion)):
        x = 0.3 * (motion.time[i + 1] - motion.time[i])
        for order, row in enumerate(motion.at(np.array([motion.time[i] + x]))):
            assert np.allclose(row[0], [curve.deriv(order)(x) for curve in curves], atol=1e-8)
