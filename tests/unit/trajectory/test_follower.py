from __future__ import annotations

import copy
import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from support.examples import examples
from support.trajectories import HOME, RATE_LIMITS, ROBOT, curved_path, moved, rest_to_rest, trapezoid
from zarm_trajectory.arrays import Array
from zarm_trajectory.follower import CATCH_UP, TICK, Follower
from zarm_trajectory.rate_bounds import RateLimits
from zarm_trajectory.trajectory import TimedTrajectory

LIMIT = np.array(ROBOT.descriptor.cspace.acceleration)
VELOCITY = np.array(ROBOT.descriptor.cspace.velocity)
ROUNDING = 1.005
"""The path bends within a tick; what the follower looks ahead leaves this much at most."""


def followed(follower: Follower) -> Array:
    """Commanded positions, tick by tick, until nothing changes any more; from rest and to rest."""
    positions = [follower.position, follower.position]
    while not follower.settled:
        follower.advance(TICK)
        positions.append(follower.position)
    return np.array([*positions, follower.position])


def accelerations(positions: Array) -> Array:
    return np.diff(positions, 2, axis=0) / TICK**2


class Recorded(Follower):
    """A follower that keeps what it did: spans of time in which the rate changes evenly."""

    spans: list[tuple[float, ...]]

    def _pass(self, dt: float, change: float) -> None:
        self.spans.append((*self.state, change, dt))
        super()._pass(dt, change)


def commanded(follower: Recorded, looks: int = 6) -> tuple[Array, Array]:
    """Acceleration and jerk (N, J) of all that was commanded, by the chain rule, at so many moments of each span."""
    time, speed, rate, change, dt = np.array(follower.spans).T[:, :, None]
    h = dt * np.linspace(0.0, 1.0, looks)
    path = follower.trajectory
    s = (time + h * (speed + h * (rate / 2 + h * change / 6))).clip(path.begin, path.duration).ravel()
    x = (speed + h * (rate + h * change / 2)).ravel()[:, None]
    a = (rate + h * change).ravel()[:, None]
    u = np.broadcast_to(change, h.shape).ravel()[:, None]
    _, slope, bend = path.sample(s)
    return bend * x**2 + slope * a, path.jerks(s) * x**3 + 3 * bend * x * a + slope * u


def distance_from(path: TimedTrajectory, positions: Array) -> float:
    """Greatest distance (rad, any joint) of positions from the path, found on a fine grid of it."""
    grid = np.array([path.at(time)[0] for time in np.arange(0.0, path.duration, TICK / 10)])
    return max(float(np.min(np.max(np.abs(grid - position), axis=1))) for position in positions)


def test_undisturbed_the_robot_is_on_time_on_the_path() -> None:
    path = curved_path(1)
    follower = Follower(path, RATE_LIMITS)
    for tick in range(1, 50):
        follower.advance(TICK)
        np.testing.assert_allclose(follower.position, path.at(tick * TICK)[0], atol=1e-12)
        np.testing.assert_allclose(follower.velocity, path.at(tick * TICK)[1], atol=1e-9)


@pytest.mark.lengthy
@examples(0.4)
@given(seed=st.integers(0, 2**32 - 1), when=st.floats(0.0, 1.0))
def test_braking_and_resuming_keep_limits_and_path(seed: int, when: float) -> None:
    path = curved_path(seed)
    follower = Follower(path, RATE_LIMITS)
    while follower.time < when * path.duration:
        follower.advance(TICK)
    before = follower.position - follower.velocity * TICK
    follower.target = 0.0
    braking = np.vstack((before, followed(follower)[1:]))
    assert follower.at_rest
    assert np.all(np.abs(accelerations(braking)[1:]) <= LIMIT * ROUNDING)
    assert distance_from(path, braking[1::10]) < 2e-3
    follower.target = 1.0
    going_on = followed(follower)
    assert follower.finished
    assert np.all(np.abs(accelerations(going_on)) <= LIMIT * ROUNDING)
    np.testing.assert_allclose(going_on[-1], path.end, atol=1e-9)


def test_braking_is_as_strong_as_the_limits_allow() -> None:
    path = TimedTrajectory.of(rest_to_rest(moved(2.0)), ROBOT.descriptor.joints)
    follower = Follower(path, RATE_LIMITS)
    while follower.time < path.duration / 2:
        follower.advance(TICK)
    speed = follower.velocity[0]
    follower.target = 0.0
    needed = (len(followed(follower)) - 3) * TICK
    assert needed <= speed / LIMIT[0] * 1.05 + TICK


def test_going_on_before_rest_is_reached_is_smooth_too() -> None:
    path = curved_path(3)
    follower = Follower(path, RATE_LIMITS)
    positions = [follower.position]
    for tick in range(400):
        follower.target = 0.0 if tick % 20 < 7 else 1.0
        follower.advance(TICK)
        positions.append(follower.position)
    assert np.all(np.abs(accelerations(np.array(positions))) <= LIMIT * ROUNDING)


@pytest.mark.lengthy
@examples(0.2)
@given(
    seed=st.integers(0, 2**32 - 1),
    targets=st.lists(
        st.tuples(st.sampled_from([0.0, 0.05, 0.3, 0.7, 1.0]), st.integers(1, 40)), min_size=1, max_size=20
    ),
)
def test_any_speed_scaling_keeps_limits_and_path(seed: int, targets: list[tuple[float, int]]) -> None:
    path = curved_path(seed)
    follower = Follower(path, RATE_LIMITS)
    positions = [follower.position, follower.position]
    for target, ticks in targets:
        follower.target = target
        for _ in range(ticks):
            follower.advance(TICK)
            positions.append(follower.position)
            assert 0.0 <= follower.speed <= 1.0
    follower.target = 0.6
    positions.extend(followed(follower)[2:])
    assert follower.finished
    assert np.all(np.abs(accelerations(np.array(positions))) <= LIMIT * ROUNDING)
    assert distance_from(path, np.array(positions[::40])) < 2e-3
    np.testing.assert_allclose(positions[-1], path.end, atol=1e-9)


@examples(0.3)
@given(
    seed=st.integers(0, 2**32 - 1),
    planned=st.booleans(),
    ramp=st.sampled_from([0.002, 0.01, 0.05]),
    commands=st.lists(
        st.tuples(st.sampled_from([0.0, 0.05, 0.3, 0.7, 1.0]), st.integers(1, 40)), min_size=1, max_size=12
    ),
    ticks=st.lists(st.sampled_from([0.002, 0.004, 0.0081, 0.01, 0.013, 0.05]), min_size=1, max_size=7),
)
def test_any_ticks_and_commands_keep_jerk_and_stop_in_time(
    seed: int, planned: bool, ramp: float, commands: list[tuple[float, int]], ticks: list[float]
) -> None:
    """`ramp` is the time from no acceleration to its limit, of the M1013, of a UR and of a slower arm.

    The curves are at their limits nearly everywhere, and a hundredth beyond; what is planned holds 0.1 % of jerk.
    """
    limits = RateLimits(RATE_LIMITS.acceleration, RATE_LIMITS.acceleration / ramp)
    follower = Recorded(planned_path(seed, ramp) if planned else curved_path(seed), limits)
    follower.spans = []
    tick = itertools.cycle(ticks)
    for target, count in (*commands, (0.0, 0)):
        follower.target = target
        for _ in range(count):
            before = follower.time
            follower.advance(next(tick))
            assert follower.time >= before
            assert 0.0 <= follower.speed <= 1.0
    took = 0.0
    while not follower.settled:
        dt = next(tick)
        follower.advance(dt)
        took += dt
    assert took <= 1.3 * np.max(VELOCITY / limits.acceleration) + limits.ramp + 3 * TICK + max(ticks)
    acceleration, jerk = commanded(follower)
    assert np.all(np.abs(acceleration) <= limits.acceleration * 1.03)
    assert np.all(np.abs(jerk) <= limits.jerk * 1.06)


def planned_path(seed: int, ramp: float | None = None) -> TimedTrajectory:
    """A motion as a planner times it, at the limits from the first milliseconds, or after `ramp` s."""
    random = np.random.default_rng(seed)
    goal = HOME + random.uniform(-0.2, 0.2, len(HOME))
    share = float(random.uniform(0.98, 1.01))  # checks let a hundredth pass
    return TimedTrajectory.of(
        trapezoid(goal, share=share, dt=float(random.uniform(0.01, 0.05)), ramp=ramp), ROBOT.descriptor.joints
    )


@pytest.mark.lengthy
@examples(0.06)
@given(seed=st.integers(0, 2**32 - 1), speed=st.sampled_from([0.5, 0.05, 1.0]))
def test_a_pause_at_every_tick_rests_and_resumes_to_the_end(seed: int, speed: float) -> None:
    follower = Follower(planned_path(seed), RATE_LIMITS)
    while not follower.finished:
        other = copy.copy(follower)
        for target in (0.0, speed):
            other.target = target
            other.ahead(0.05)  # is not without end
            for _ in range(math.ceil(2.5 * other.trajectory.duration / speed / TICK)):
                other.advance(TICK)
                if other.settled:
                    break
            assert other.settled, f"at {follower.time} s, asked for {target}"
        assert other.finished
        follower.advance(TICK)


@examples(0.1)
@given(seed=st.integers(0, 2**32 - 1), tick=st.integers(0, 5))
def test_resuming_just_after_the_start_keeps_limits_and_time(seed: int, tick: int) -> None:
    follower = Follower(planned_path(seed), RATE_LIMITS)
    for _ in range(tick):
        follower.advance(0.004)
    follower.target = 0.0
    followed(follower)
    follower.target = 1.0
    positions = followed(follower)
    assert np.all(np.abs(accelerations(positions)) <= LIMIT * 1.01 * ROUNDING)
    assert len(positions) * TICK <= follower.trajectory.duration + 0.1


@pytest.mark.lengthy
@pytest.mark.parametrize("speed", [0.05, 0.5])
def test_a_lower_path_speed_takes_proportionally_longer(speed: float) -> None:
    path = curved_path(6)
    follower = Follower(path, RATE_LIMITS, speed=speed, target=speed)
    ticks = len(followed(follower)) - 3
    assert ticks * TICK == pytest.approx(path.duration / speed, rel=0.01)


@pytest.mark.parametrize("target", [0.05, 0.4])
def test_the_preview_is_what_will_be_commanded(target: float) -> None:
    path = curved_path(7)
    follower = Follower(path, RATE_LIMITS, time=path.duration / 3, target=target)
    ahead = follower.ahead(TICK)
    for position in ahead.points.position[:200]:
        np.testing.assert_allclose(follower.position, position, atol=1e-9)
        follower.advance(TICK)
    np.testing.assert_allclose(ahead.points.position[-1], path.end, atol=1e-9)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.95])
def test_a_rest_is_foretold_as_the_braking_to_it_says(share: float) -> None:
    path = curved_path(7)
    follower = Follower(path, RATE_LIMITS, time=share * path.duration)
    braking = follower.braking(0.02)
    assert follower.rest(follower.state, 0.02) == (0.02 * braking.last, braking.path_time[-1])


def test_a_short_pause_between_ticks_is_caught_up_with() -> None:
    path = curved_path(4)
    late, on_time = Follower(path, RATE_LIMITS), Follower(path, RATE_LIMITS)
    late.advance(CATCH_UP)
    for _ in range(round(CATCH_UP / TICK)):
        on_time.advance(TICK)
    np.testing.assert_allclose(late.position, on_time.position, atol=1e-12)


def test_after_a_long_gap_between_ticks_it_restarts_from_rest() -> None:
    path = curved_path(5)
    follower = Follower(path, RATE_LIMITS)
    while follower.time < path.duration / 2:
        follower.advance(TICK)
    stood = follower.position.copy()
    follower.advance(CATCH_UP + TICK)
    np.testing.assert_array_equal(follower.position, stood)
    np.testing.assert_array_equal(follower.velocity, np.zeros(6))
    going_on = followed(follower)
    assert np.all(np.abs(accelerations(going_on)) <= LIMIT * ROUNDING)
    np.testing.assert_allclose(going_on[-1], path.end, atol=1e-9)
