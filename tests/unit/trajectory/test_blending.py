"""Leading the robot from one motion over to another keeps every limit, and never jumps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from support.examples import examples
from support.executor.waves import chunk
from support.trajectories import HOME, RATE_LIMITS, ROBOT, moved, rest_to_rest
from zarm_contract.errors import ExecutionRefused, InvalidRequest
from zarm_trajectory.arrays import Array
from zarm_trajectory.blending import PAST, blended
from zarm_trajectory.follower import TICK, Follower
from zarm_trajectory.limits import LIMIT_TOLERANCE, Limits
from zarm_trajectory.trajectory import TimedTrajectory

JOINTS = ROBOT.descriptor.joints
LIMITS = Limits.of(ROBOT)
LIMIT = np.array(ROBOT.descriptor.cspace.acceleration)


def swing(*distances: float, start: Array = HOME, slower: float = 1.5) -> TimedTrajectory:
    return TimedTrajectory.of(rest_to_rest(moved(*distances, start=start), start, slower=slower), JOINTS)


@examples(0.4)
@given(
    first=st.lists(st.floats(-0.6, 0.6), min_size=3, max_size=3),  # both together inside the range of joint 3
    second=st.lists(st.floats(-0.6, 0.6), min_size=3, max_size=3),
    when=st.floats(0.0, 1.2),
    begun=st.floats(-0.5, 0.5),
    target=st.sampled_from([0.1, 0.5, 1.0]),
)
def test_joined_motions_keep_limits_without_a_jump(
    first: list[float], second: list[float], when: float, begun: float, target: float
) -> None:
    old = swing(*first)
    now = when * old.duration
    new = swing(*second, start=old.at(now)[0])
    follower = Follower(old, RATE_LIMITS)
    positions = [follower.position, follower.position]
    while follower.time < now and not follower.finished:
        follower.advance(TICK)
        positions.append(follower.position)
    follower.target = target
    before = (follower.position, follower.velocity)
    try:
        joined = blended(old, follower.time, new, follower.time + begun, LIMITS)
    except ExecutionRefused:
        joined = old
    follower.join(joined)
    if joined is not old:
        LIMITS.check(joined)
        assert joined.duration >= follower.time + begun + new.duration - 1e-9
        np.testing.assert_allclose(joined.end, new.end, atol=1e-12)
    np.testing.assert_allclose(follower.position, before[0], atol=1e-12)
    np.testing.assert_allclose(follower.velocity, before[1], atol=1e-7)
    while not follower.settled:
        follower.advance(TICK)
        positions.append(follower.position)
    positions.append(follower.position)
    # LIMIT_TOLERANCE is what the paths themselves may be above their limits
    assert np.all(np.abs(np.diff(positions, 2, axis=0)) / TICK**2 <= LIMIT * LIMIT_TOLERANCE * 1.005)


def test_a_matching_chunk_changes_only_the_end() -> None:
    path = chunk(0.0)
    for start in (0.05, 0.1, 0.15):
        path = blended(path, start, chunk(start), start, LIMITS)
    for time in (0.0, 0.04, 0.12, 0.2, 0.3):
        np.testing.assert_allclose(path.at(time)[0], chunk(0.0, 0.5).at(time)[0], atol=1e-5)
    assert path.duration == pytest.approx(0.15 + 0.2 + 0.8)


def test_a_chunk_is_joined_in_the_shortest_feasible_time() -> None:
    near, far = (blended(chunk(0.0), 0.1, chunk(0.1, off=off), 0.1, LIMITS) for off in (0.001, 0.02))
    assert near.at(0.1 + 0.1)[0][0] == pytest.approx(chunk(0.1, off=0.001).at(0.1)[0][0], abs=1e-9)
    assert far.at(0.1 + 0.1)[0][0] < chunk(0.1, off=0.02).at(0.1)[0][0] - 0.005
    LIMITS.check(near)
    LIMITS.check(far)


@pytest.mark.parametrize("jerk", [500.0, 50.0, 10.0])
def test_a_chunk_is_joined_within_the_jerk_limit(jerk: float) -> None:
    cspace = ROBOT.descriptor.cspace.model_copy(update={"jerk": (jerk,) * 6})
    descriptor = ROBOT.descriptor.model_copy(update={"cspace": cspace})
    joined = blended(chunk(0.0), 0.1, chunk(0.1, off=0.001), 0.1, Limits.of(replace(ROBOT, descriptor=descriptor)))
    times = np.linspace(0.0, 0.8, 8001)
    change = np.abs(np.diff(joined.sample(times)[2], axis=0)).max()
    assert change <= jerk * LIMIT_TOLERANCE * times[1] * 1.001


@pytest.mark.parametrize("off", [1e-6, 1e-5, 1e-4, 1e-3])
def test_a_chunk_just_beside_the_motion_is_followed_on_time(off: float) -> None:
    """A robot that measures its joints is a little off what it was told; it must not fall behind for that."""
    old, now = swing(0.6, -0.4, slower=1.02), 0.3
    new = old.since(now).begun_at(-now)
    beside = replace(new, position=new.position + off)
    joined = blended(old, now, beside, now, LIMITS)
    LIMITS.check(joined)
    assert joined.duration == pytest.approx(old.duration, abs=1e-9)
    times = np.linspace(now, old.duration, 300)
    behind = joined.positions(times) - old.positions(times)
    assert np.abs(behind[0]).max() < 1e-9
    assert behind.min() > -1e-9
    assert behind.max() < off + 1e-9
    np.testing.assert_allclose(joined.end, beside.end, atol=1e-12)


def test_a_chunk_out_of_reach_is_refused() -> None:
    with pytest.raises(ExecutionRefused, match=r"0\.5000 rad from the motion") as refusal:
        blended(chunk(0.0), 0.1, chunk(0.1, off=0.5), 0.1, LIMITS)
    assert refusal.value.code == "limit_violated"


def test_an_unreachable_chunk_does_not_complete_the_old_motion() -> None:
    moving = swing(1.5)
    now = 0.3 * moving.duration
    with pytest.raises(ExecutionRefused):
        blended(moving, now, TimedTrajectory.standing(moving.end), now, LIMITS)


def test_a_chunk_that_starts_long_after_the_motion_is_refused() -> None:
    with pytest.raises(InvalidRequest) as refusal:
        blended(chunk(0.0), 0.1, chunk(0.0), 1e6, LIMITS)
    assert refusal.value.problem.field == "start"


def test_a_chunk_that_starts_later_is_waited_for_at_rest() -> None:
    path = TimedTrajectory.standing(HOME)
    joined = blended(path, 0.5, chunk(0.0), 3.0, LIMITS)
    for time in (0.6, 1.5, 2.9):
        np.testing.assert_allclose(joined.at(time), np.vstack((HOME, np.zeros((2, 6)))), atol=1e-9)
    assert joined.duration == pytest.approx(4.0)


def test_a_path_forgets_what_is_long_past_and_keeps_what_is_not() -> None:
    path = chunk(0.0)
    for index in range(1, 200):
        start = index * 0.05
        path = blended(path, start, chunk(start), start, LIMITS)
    assert path.time[0] == pytest.approx(start - PAST, abs=0.06)
    assert len(path.time) < 200
    np.testing.assert_allclose(path.at(start - 1.0)[0][0] - HOME[0], chunk(start - 1.0).start[0] - HOME[0], atol=1e-4)
