"""A higher limit makes no motion slower, however far apart limits are, and one that cannot be reached changes nothing."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from support.examples import examples
from zarm_contract.errors import InvalidRequest
from zarm_contract.robot import load_robot
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.deadline import Deadline
from zarm_planner.timing.averaging import Averaging
from zarm_planner.timing.smoothing import smooth_path
from zarm_planner.timing.time_parameterization import time_path
from zarm_trajectory.arrays import Array
from zarm_trajectory.limits import Limits
from zarm_trajectory.trajectory import TimedTrajectory

MODEL = RobotModel.of(load_robot("doosan_m1013"))
HOME = np.array(MODEL.robot.descriptor.home)
DT = 0.02
SHARE = 1.01
"""Sample times are those of the motion's knots or in between, so a motion may be 0.5 % longer by where they fall."""
ANY = st.floats(-6, 6).map(lambda exponent: 10.0**exponent)
EACH = st.lists(ANY, min_size=6, max_size=6).map(np.array)
RATES = st.tuples(EACH, EACH, EACH).map(np.stack)
WAY = st.lists(st.integers(-450, 450), min_size=6, max_size=6).map(lambda milliradians: 1e-3 * np.array(milliradians))
HIGHER = st.tuples(
    st.sampled_from((0, 1, 2)), st.sampled_from((0, 1, 2, 3, 4, 5, slice(None))), st.floats(0, 6).map(lambda x: 10.0**x)
)


def limits(rates: Array) -> Limits:
    return Limits(MODEL.robot.descriptor.joints, MODEL.lower, MODEL.upper, *rates)


def raised(rates: Array, change: tuple[int, int | slice, float]) -> Array:
    """The limits with one of them higher, for one joint or all."""
    row, joint, factor = change
    higher = rates.copy()
    higher[row, joint] *= factor
    return higher


def smooth(path: Array, rates: Array) -> TimedTrajectory:
    return smooth_path(MODEL, World((), 0.0), path, limits(rates), DT, seed=0, deadline=Deadline(60.0))


def straight(path: Array, rates: Array) -> TimedTrajectory:
    return time_path(path, limits(rates), DT, 0.0)


def duration(timing: Callable[[Array, Array], TimedTrajectory], path: Array, rates: Array) -> float:
    """Of the motion along a path; infinite if it is longer than a message."""
    try:
        return timing(path, rates).duration
    except InvalidRequest:
        return math.inf


@pytest.mark.parametrize("acceleration", [5.0, 100.0, 1e3, 1e5])
def test_out_of_reach_acceleration_limits_change_nothing(acceleration: float) -> None:
    rates = np.array([[1.0] * 6, [acceleration] * 6, [50.0] * 6])
    way = 0.1 * np.eye(6)[0]
    assert duration(smooth, np.stack((HOME, HOME + way)), rates) == pytest.approx(0.48, rel=0.01)


@examples(1)
@given(way=WAY, rates=RATES, change=HIGHER)
def test_a_higher_limit_makes_no_motion_slower(
    way: Array, rates: Array, change: tuple[int, int | slice, float]
) -> None:
    path = np.stack((HOME, HOME + way))
    assert duration(smooth, path, raised(rates, change)) <= SHARE * duration(smooth, path, rates)


@examples(0.5)
@given(way=WAY, rates=RATES, change=HIGHER)
def test_a_higher_limit_makes_no_straight_motion_slower(
    way: Array, rates: Array, change: tuple[int, int | slice, float]
) -> None:
    path = np.stack((HOME, HOME + way))
    before, after = (duration(straight, path, one) for one in (rates, raised(rates, change)))
    assert after <= SHARE * before


@examples(5)
@given(ways=st.lists(st.floats(0, 6), min_size=6, max_size=6).map(np.array), rates=RATES, change=HIGHER)
def test_the_bound_on_a_duration_never_grows_with_a_limit(
    ways: Array, rates: Array, change: tuple[int, int | slice, float]
) -> None:
    least = Averaging.of(ways, rates, 0.1 * DT).duration
    assert Averaging.of(ways, raised(rates, change), 0.1 * DT).duration <= least * (1 + 1e-6)


def test_limits_out_of_reach_change_nothing_at_all() -> None:
    path = np.stack((HOME, HOME + 0.2))
    rates = np.array([[50.0] * 6, [200.0] * 6, [40.0] * 6])
    motions = [smooth(path, rates * scale) for scale in (1.0, np.array([[1e4], [1e4], [1.0]]))]
    for one, other in zip(*(motion.states for motion in motions), strict=True):
        np.testing.assert_array_equal(one, other)
