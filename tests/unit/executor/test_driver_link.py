"""The link to a driver: joints by name, ages by the executor's clock, columns in the driver's order."""

from __future__ import annotations

import itertools
import logging
import time
from collections.abc import Iterator

import numpy as np
import pytest

from support.executor.driver_bench import robot_with
from support.harness import eventually
from support.trajectories import HOME, KEYS, RATE_LIMITS, moved, rest_to_rest
from zarm_contract.messages import DriverCommand, DriverProgress, JointState
from zarm_executor.strategies.driver_link import DriverLink
from zarm_runtime.bus import Bus
from zarm_trajectory.follower import Follower
from zarm_trajectory.trajectory import TimedTrajectory

ORDER = ("joint_6", "joint_1", "joint_3", "joint_2", "joint_4", "joint_5")
ROBOT = robot_with(joint_order=ORDER)
JOINTS = ROBOT.descriptor.joints


@pytest.fixture
def link(endpoint: str) -> Iterator[DriverLink]:
    assert ROBOT.descriptor.strategy_params is not None
    with Bus(endpoint) as bus:
        yield DriverLink(bus, KEYS, ROBOT, ROBOT.descriptor.strategy_params)


def state(names: tuple[str, ...], values: tuple[float, ...]) -> JointState:
    return JointState(stamp=0.0, joint_names=names, position=values, velocity=tuple(-value for value in values))


def test_joint_states_are_read_by_name_in_any_order(link: DriverLink, bus: Bus) -> None:
    assert link.measured() is None
    assert "start the robot's driver" in (link.obstacle() or "")
    driver = bus.publisher(KEYS.driver_joint_states)
    before = time.monotonic()
    driver.put(state(("gripper", *ORDER), (9.0, 6.0, 1.0, 3.0, 2.0, 4.0, 5.0)))
    measured = eventually(link.measured, "the joints arrive")
    np.testing.assert_array_equal(measured.position, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    np.testing.assert_array_equal(measured.velocity, -measured.position)
    assert before < measured.time < time.monotonic()
    assert link.measured() is measured  # nothing new: the same, with its age
    eventually(lambda: "joint_state_timeout" in (link.obstacle() or ""), "the joints are old")


def test_foreign_and_invalid_joints_are_ignored_and_logged_once(
    link: DriverLink, bus: Bus, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.WARNING)
    driver = bus.publisher(KEYS.driver_joint_states)
    driver.put(state(JOINTS, (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)))
    good = eventually(link.measured, "the joints arrive")
    for _ in range(3):
        driver.put(state(("a", "b"), (0.0, 0.0)))
        eventually(lambda: link.measured() is good and "another robot" in caplog.text, "the stranger was looked at")
    assert caplog.text.count("another robot") == 1


def test_joints_repeated_with_one_stamp_grow_old(link: DriverLink, bus: Bus) -> None:
    driver = bus.publisher(KEYS.driver_joint_states)
    newest = link._states
    frozen = state(JOINTS, (1.0, 2.0, 3.0, 4.0, 5.0, 6.0))
    driver.put(frozen)
    first = eventually(link.measured, "the joints arrive")
    driver.put(frozen)
    eventually(lambda: (reported := newest.received()) and reported[1] > first.time, "the same is told again")
    assert link.measured() is first
    news = frozen.model_copy(update={"stamp": -3600.0})  # whatever the driver's clock does
    eventually(lambda: driver.put(news) or link.measured() is not first, "the joints are measured again")


def test_after_a_silence_what_was_told_during_it_is_passed_over(link: DriverLink, bus: Bus) -> None:
    driver = bus.publisher(KEYS.driver_joint_states)
    reported = state(JOINTS, (1.0, 2.0, 3.0, 4.0, 5.0, 6.0))
    driver.put(reported)
    first = eventually(link.measured, "the joints arrive")
    eventually(lambda: time.monotonic() - first.time > 0.3, "the driver is silent for long")
    newest = link._states
    driver.put(reported.model_copy(update={"stamp": 0.01}))
    eventually(lambda: (late := newest.received()) and late[1] > first.time, "what was held up arrives")
    assert link.measured() is first
    driver.put(reported.model_copy(update={"stamp": 60.0}))
    eventually(lambda: link.measured() is not first, "the joints are measured again")


@pytest.mark.lengthy
def test_a_driver_whose_clock_was_set_back_is_received_again(link: DriverLink, bus: Bus) -> None:
    driver = bus.publisher(KEYS.driver_joint_states)
    reported = state(JOINTS, (1.0, 2.0, 3.0, 4.0, 5.0, 6.0))
    driver.put(reported)
    first = eventually(link.measured, "the joints arrive")
    eventually(lambda: time.monotonic() - first.time > 0.3, "the driver is silent for long")
    stepped = (reported.model_copy(update={"stamp": -3600.0 + count}) for count in itertools.count())
    eventually(lambda: driver.put(next(stepped)) or link.measured() is not first, "the joints are measured again")


def test_a_command_has_its_columns_in_the_drivers_order(link: DriverLink, bus: Bus) -> None:
    commands: list[DriverCommand] = []
    bus.subscribe(KEYS.driver_command, lambda _, command: commands.append(command))
    driver = bus.publisher(KEYS.driver_joint_states)
    driver.put(state(JOINTS, (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)))
    eventually(link.measured, "the joints arrive")
    path = TimedTrajectory.of(rest_to_rest(moved(0.1, 0.2, 0.3)), JOINTS)
    points = Follower(path, link.limits).ahead(0.02)

    def sent() -> bool:  # a real-time publication may be dropped until the router knows the subscriber
        link.send(points.points)
        return bool(commands)

    eventually(sent, "the command arrives")
    command = commands[-1]
    assert command.joint_names == ORDER
    columns = [JOINTS.index(name) for name in ORDER]
    np.testing.assert_array_equal(command.position, points.points.position[:, columns])
    np.testing.assert_array_equal(command.velocity, points.points.velocity[:, columns])
    np.testing.assert_allclose(command.position[-1], path.end[columns])
    np.testing.assert_allclose(np.diff(command.time), 0.02)
    number = link.stop()
    eventually(lambda: commands[-1].sequence == number, "the stop arrives")  # behind the commands still under way
    assert commands[-1] == DriverCommand(sequence=number, joint_names=ORDER)


def test_progress_counts_for_the_command_that_it_names(link: DriverLink, bus: Bus) -> None:
    progress = bus.publisher(KEYS.driver_progress)
    progress.put(DriverProgress(sequence=3, fraction=0.25))
    assert eventually(lambda: link.fraction(3), "the progress arrives") == 0.25
    assert link.fraction(4) is None


# --- what lies ahead of a follower ---


def test_what_lies_ahead_is_what_the_follower_then_does() -> None:
    path = TimedTrajectory.of(rest_to_rest(moved(1.0, -0.5)), JOINTS)
    for target, time_, speed in ((1.0, 0.0, 1.0), (0.0, 1.0, 1.0), (1.0, 1.0, 0.0), (1.0, 0.5, 0.4)):
        follower = Follower(path, RATE_LIMITS, time=time_, speed=speed, target=target)
        ahead = follower.ahead(0.02)
        for index in range(len(ahead)):
            np.testing.assert_allclose(ahead.points.position[index], follower.position, atol=1e-9)
            np.testing.assert_allclose(ahead.points.velocity[index], follower.velocity, atol=1e-9)
            assert ahead.at(index)[0] == pytest.approx(follower.time)
            follower.advance(0.02)
        assert follower.settled
        assert not ahead.points.velocity[-1].any()
        assert np.max(np.abs(ahead.points.acceleration)) <= 1.02
        assert np.max(np.abs(np.diff(ahead.points.velocity, axis=0))) / 0.02 <= 1.01


def test_a_chunk_has_as_many_points_as_asked_and_ends_at_rest() -> None:
    path = TimedTrajectory.of(rest_to_rest(moved(0.05)), JOINTS)
    ahead = Follower(path, RATE_LIMITS).ahead(0.02, 100)
    assert ahead.points.position.shape == (100, 6)
    np.testing.assert_allclose(ahead.points.position[-1], path.end)
    np.testing.assert_array_equal(ahead.points.position[0], HOME)
    assert not ahead.points.velocity[-50:].any()
