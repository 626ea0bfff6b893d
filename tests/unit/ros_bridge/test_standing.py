"""All joint states of a robot that moves are passed on, and some of one that stands."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import pytest

from zarm_contract.messages import JointState
from zarm_ros_bridge.drivers.standing import Standing

TIMEOUT = 0.1


def passed(at: Callable[[float], float], speed: float = 0.0, timeout: float = TIMEOUT) -> int:
    """How many of a second at 100 Hz are, where the second joint is `at` a position (rad) by the time (s)."""
    standing, count = Standing(timeout), 0
    for step in range(100):
        state = JointState(stamp=step, joint_names=("a", "b"), position=(1.0, at(step / 100)), velocity=(0.0, speed))
        count += standing.passes(state, step / 100)
    return count


def test_of_a_robot_that_stands_some_are_passed_on() -> None:
    assert passed(lambda _: 0.5) == 17


def test_they_are_frequent_enough_for_a_planner() -> None:
    assert passed(lambda _: 0.5, timeout=5.0) == 10


def test_they_are_more_frequent_for_an_impatient_executor() -> None:
    standing = Standing(0.02)
    state = JointState(stamp=0.0, joint_names=("a",), position=(0.0,), velocity=(0.0,))
    assert [standing.passes(state, step / 100) for step in range(3)] == [True, True, True]


@pytest.mark.parametrize("period", [0.001, 0.007, 0.013, 0.02, 0.035, 0.05, 0.08])
def test_they_are_never_further_apart_than_the_executor_waits(period: float) -> None:
    standing, at = Standing(TIMEOUT), []
    for step in range(100):
        state = JointState(stamp=0.0, joint_names=("a",), position=(0.0,), velocity=(0.0,))
        if standing.passes(state, step * period):
            at.append(step * period)
    assert max(after - before for before, after in pairwise(at)) < max(0.7 * TIMEOUT, 1.01 * period)


def test_noise_of_an_encoder_is_no_motion() -> None:
    assert passed(lambda time: 0.5 + 2e-5 * (round(time * 100) % 3)) == 17


def test_all_are_of_a_robot_that_moves() -> None:
    assert passed(lambda time: 0.02 * time) == 100


def test_all_are_of_a_robot_that_tells_a_velocity() -> None:
    assert passed(lambda _: 0.5, speed=-0.01) == 100


def test_the_first_that_moves_is_passed_on_at_once() -> None:
    standing = Standing(TIMEOUT)
    for now, at, due in ((0.0, 0.0, True), (0.01, 0.0, False), (0.02, 0.001, True), (0.03, 0.001, False)):
        state = JointState(stamp=now, joint_names=("a",), position=(at,), velocity=(0.0,))
        assert standing.passes(state, now) == due


def test_the_interval_at_rest_grows_within_bounds() -> None:
    for timeout in (0.02, TIMEOUT):
        standing, pauses = Standing(timeout), []
        for step, position in enumerate((0.0, 0.0, 0.001, 0.001)):
            state = JointState(stamp=step, joint_names=("a",), position=(position,), velocity=(0.0,))
            standing.passes(state, step * timeout)
            pauses.append(standing.pause)
        assert pauses[0] is pauses[2] is None
        assert all(0.0 < (pause or 0.0) < 0.4 * timeout for pause in pauses[1::2])
