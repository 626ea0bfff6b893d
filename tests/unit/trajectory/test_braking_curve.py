from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from support.examples import examples
from support.trajectories import ROBOT, curved_path, moved, rest_to_rest
from zarm_trajectory.braking_curve import BrakingCurve
from zarm_trajectory.follower import TICK, Follower
from zarm_trajectory.trajectory import TimedTrajectory

LIMIT = np.array(ROBOT.descriptor.cspace.acceleration)


def rest(follower: Follower) -> float:
    """The path time at which it rests when it brakes from now on."""
    follower.target = 0.0
    while not follower.settled:
        follower.advance(TICK)
    return follower.time


@examples(0.4)
@given(seed=st.integers(0, 2**32 - 1), where=st.floats(0.05, 0.95), speed=st.sampled_from([0.05, 0.3, 1.0]))
def test_a_robot_that_brakes_when_it_reaches_the_curve_rests_before_its_end_and_not_long_before(
    seed: int, where: float, speed: float
) -> None:
    trajectory = curved_path(seed)
    end = where * trajectory.duration
    curve = BrakingCurve(trajectory, end, LIMIT)
    follower = Follower(trajectory, LIMIT, speed=speed, target=speed)
    assume(curve.speed(TICK) >= speed)
    while follower.speed <= curve.speed(follower.time + 2 * TICK * follower.speed):
        follower.advance(TICK)
    found = rest(follower)
    assert found <= end
    assert end - found < 0.1


def test_it_is_the_parabola_of_the_limit_where_the_trajectory_is_straight() -> None:
    trajectory = TimedTrajectory.of(rest_to_rest(moved(3.0), slower=2.0), ROBOT.descriptor.joints)
    middle = trajectory.duration / 2
    velocity, limit = abs(trajectory.at(middle)[1][0]), LIMIT[0]
    curve = BrakingCurve(trajectory, middle, LIMIT)
    assert curve.speed(middle) == curve.speed(trajectory.duration) == 0.0
    assert curve.speed(middle - 0.05) == pytest.approx(np.sqrt(2 * 0.98 * limit * 0.05 / velocity), rel=0.02)
    assert curve.speed(0.0) == 1.0
