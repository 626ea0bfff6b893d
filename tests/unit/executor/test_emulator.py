from __future__ import annotations

import logging
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path as Folder

import numpy as np
import pytest

from support.harness import eventually
from support.trajectories import HOME, RATE_LIMITS, ROBOT, moved, rest_to_rest
from zarm_contract.errors import Unavailable
from zarm_contract.messages import JointState
from zarm_executor.strategies.emulator import EmulatedRobot, Emulator
from zarm_runtime.state_file import StateFile
from zarm_trajectory.follower import TICK
from zarm_trajectory.rate_bounds import RateLimits
from zarm_trajectory.trajectory import TimedTrajectory

JOINTS = ROBOT.descriptor.joints


def saved_in(folder: Folder) -> StateFile[JointState]:
    return StateFile(folder / "emulated_robot.json", JointState)


def emulator_in(folder: Folder) -> Emulator:
    return Emulator(EmulatedRobot(ROBOT.descriptor, saved_in(folder)), RATE_LIMITS)


def position(emulator: Emulator) -> np.ndarray:
    measured = emulator.joint_state()
    assert measured is not None
    return measured.position


def play(emulator: Emulator, seconds: float, now: float = 0.0) -> None:
    for tick in range(round(seconds / TICK)):
        emulator.tick(now + tick * TICK, TICK)


def test_a_new_robot_is_at_home_and_at_rest(tmp_path: Folder) -> None:
    emulator = emulator_in(tmp_path)
    emulator.tick(5.0, TICK)
    measured = emulator.joint_state()
    assert measured is not None
    np.testing.assert_array_equal(measured.position, HOME)
    np.testing.assert_array_equal(measured.velocity, np.zeros(6))
    assert measured.time == 5.0


def test_it_is_measured_at_every_tick_at_rest_too(tmp_path: Folder) -> None:
    emulator = emulator_in(tmp_path)
    emulator.start(TimedTrajectory.of(rest_to_rest(moved(0.1)), JOINTS), 1.0)
    play(emulator, 2.0)
    for now in (5.0, 6.0, 7.0):
        emulator.tick(now, TICK)
        measured = emulator.joint_state()
        assert measured is not None
        assert measured.time == now


def test_it_stays_where_it_stopped_across_restarts(tmp_path: Folder) -> None:
    first = emulator_in(tmp_path)
    first.open()
    first.start(TimedTrajectory.of(rest_to_rest(moved(1.0)), JOINTS), 1.0)
    play(first, 0.7)
    first.stop()
    play(first, 3.0)
    first.close()
    assert 0.1 < position(first)[0] < 0.9
    np.testing.assert_array_equal(position(emulator_in(tmp_path)), position(first))


def test_commanded_joints_keep_jerk_through_stop_and_resume(tmp_path: Folder) -> None:
    limits = RateLimits(RATE_LIMITS.acceleration, RATE_LIMITS.acceleration / 0.1)
    emulator = Emulator(EmulatedRobot(ROBOT.descriptor, saved_in(tmp_path)), limits)
    emulator.start(TimedTrajectory.of(rest_to_rest(moved(1.0, -0.4)), JOINTS), 1.0)
    velocities = []
    for command, seconds in (
        (None, 0.7), (emulator.stop, 0.3), (lambda: emulator.move(1.0), 0.2), (lambda: emulator.move(0.3), 0.4),
        (emulator.stop, 2.0), (lambda: emulator.move(1.0), 4.0),
    ):  # fmt: skip
        if command is not None:
            command()
        for _ in range(round(seconds / TICK)):
            emulator.tick(0.0, TICK)
            measured = emulator.joint_state()
            assert measured is not None
            velocities.append(measured.velocity)
    acceleration = np.diff(velocities, axis=0) / TICK
    assert np.all(np.abs(acceleration) <= limits.acceleration * 1.01)
    assert np.all(np.abs(np.diff(acceleration, axis=0)) / TICK <= limits.jerk * 1.01)
    np.testing.assert_allclose(position(emulator), moved(1.0, -0.4), atol=1e-9)


def test_the_position_is_saved_while_it_moves(tmp_path: Folder) -> None:
    emulator = emulator_in(tmp_path)
    emulator.open()
    try:
        emulator.start(TimedTrajectory.of(rest_to_rest(moved(1.0)), JOINTS), 1.0)
        play(emulator, 0.7)
        eventually(lambda: np.array_equal(position(emulator_in(tmp_path)), position(emulator)), "the position is saved")
    finally:
        emulator.close()


def test_an_unreadable_saved_position_is_ignored_with_a_warning(
    tmp_path: Folder, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "emulated_robot.json").write_text('{"stamp": 1')
    np.testing.assert_array_equal(position(emulator_in(tmp_path)), HOME)
    assert "emulated_robot.json" in caplog.text


def test_a_saved_position_of_other_joints_is_ignored(tmp_path: Folder, caplog: pytest.LogCaptureFixture) -> None:
    saved_in(tmp_path).save(JointState(stamp=0.0, joint_names=("a",), position=(1.0,), velocity=(0.0,)))
    np.testing.assert_array_equal(position(emulator_in(tmp_path)), HOME)
    assert "starts at home" in caplog.text


def test_it_does_not_open_where_its_position_cannot_be_kept(tmp_path: Folder) -> None:
    (tmp_path / "state").write_text("a file where the folder should be")
    with pytest.raises(Unavailable, match="--state"):
        emulator_in(tmp_path / "state").open()


def test_losing_the_folder_in_motion_is_only_a_warning(tmp_path: Folder, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING)
    emulator = emulator_in(tmp_path / "state")
    emulator.open()
    try:
        (tmp_path / "state" / "emulated_robot.json").unlink()
        (tmp_path / "state").rmdir()
        (tmp_path / "state").write_text("a file where the folder should be")
        emulator.start(TimedTrajectory.of(rest_to_rest(moved(1.0)), JOINTS), 1.0)
        play(emulator, 4.0)
        eventually(lambda: "no longer saved" in caplog.text, "a warning is logged")
        np.testing.assert_allclose(position(emulator), moved(1.0), atol=1e-9)
    finally:
        emulator.close()


@pytest.mark.lengthy
def test_two_that_save_at_once_take_nothing_from_each_other(tmp_path: Folder) -> None:
    file = saved_in(tmp_path)
    message = JointState(stamp=1.0, joint_names=("a",), position=(1.0,), velocity=(0.0,))
    with ThreadPoolExecutor(8) as pool:
        for saved in [pool.submit(file.save, message) for _ in range(400)]:
            saved.result()
    assert file.load() == message
