"""The way to rest with which every streamed chunk ends."""

from __future__ import annotations

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st

from support.examples import examples
from support.trajectories import HOME, ROBOT, trapezoid
from zarm_trajectory.braking import braking
from zarm_trajectory.follower import Follower
from zarm_trajectory.trajectory import TimedTrajectory

LIMIT = np.array(ROBOT.descriptor.cspace.acceleration)
DT = 0.02
BEND = 1.005
"""A path at its limits may be above them by a hundredth, and bends within a point."""


def planned_path(seed: int) -> TimedTrajectory:
    random = np.random.default_rng(seed)
    goal = HOME + random.uniform(-1.5, 1.5, len(HOME))
    return TimedTrajectory.of(trapezoid(goal), ROBOT.descriptor.joints)


@example(seed=593, share=0.5, speed=0.8671875)  # the acceleration of the path jumps within a point
@examples(2)
@given(seed=st.integers(0, 2**32 - 1), share=st.floats(0.05, 0.999), speed=st.floats(0.01, 1.0))
def test_from_anywhere_it_leads_along_the_path_to_rest_inside_the_limits_as_fast_as_braking_step_by_step(
    seed: int, share: float, speed: float
) -> None:
    path = planned_path(seed)
    time = share * path.duration
    points = braking(path, time, speed, LIMIT, DT)
    np.testing.assert_allclose(points.points.position[0], path.at(time)[0])
    np.testing.assert_allclose(points.points.velocity[0], path.at(time)[1] * speed)
    np.testing.assert_array_equal(points.points.velocity[-1], np.zeros(6))
    np.testing.assert_allclose(points.points.position, path.sample(points.path_time)[0])
    assert np.all(np.diff(points.path_time) >= 0.0)
    change = np.abs(np.diff(points.points.velocity, axis=0)) / DT
    assert np.all(change <= LIMIT * BEND), change.max()
    follower = Follower(path, LIMIT, time=time, speed=speed, target=0.0)
    assert len(points) <= len(follower.ahead(DT)) + 3


def test_at_rest_there_is_nothing_to_brake() -> None:
    path = planned_path(1)
    for time, speed in ((0.5, 0.0), (path.duration, 1.0)):
        assert len(braking(path, time, speed, LIMIT, DT)) == 1
