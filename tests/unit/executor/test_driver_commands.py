"""What strategies send to a driver: inside the bounds, without a gap, and only so much as the robot may move by itself."""

from __future__ import annotations

import itertools
from pathlib import Path as Folder

import numpy as np

from support.executor.driven import FAR, LIMIT
from support.executor.driver_bench import MOVING, Case, DriverBench
from zarm_executor.machine import STALL_LIMIT


def test_velocity_commands_keep_the_bounds_from_anywhere(tmp_path: Folder) -> None:
    bench = DriverBench(Case("joint_speed"), tmp_path)
    bench.execute()
    for push in (0.1, -0.15, 0.12, -0.1):
        bench.run(0.3)
        bench.arm.position = bench.arm.position + push * np.array([1, -1, 1, -1, 1, -1])
    bench.until("idle")
    assert bench.last().status == "succeeded"
    assert bench.commanded_acceleration() <= LIMIT * 1.001
    assert max(np.abs(command.velocity).max() for _, command in bench.commands if command.time) <= 1.2


def test_commands_are_published_as_sent_and_consistent(tmp_path: Folder) -> None:
    bench = DriverBench(Case("joint_speed"), tmp_path)
    bench.execute()
    bench.until("idle")
    chunks = [(at, command) for at, command in bench.commands if command.time]
    for (at, before), (later, after) in itertools.pairwise(chunks):
        assert after.sequence == before.sequence + 1
        played = round((later - at) / 0.02)
        if played <= len(before.velocity):
            step = np.subtract(after.velocity[0], before.velocity[played - 1])
            assert np.max(np.abs(step)) <= LIMIT * 0.02 + 1e-9
            np.testing.assert_allclose(after.acceleration[0], step / 0.02, atol=1e-9)
        inside = np.diff(after.velocity, axis=0)
        assert np.max(np.abs(inside)) <= LIMIT * 0.02 + 1e-9
        np.testing.assert_allclose(after.acceleration[1:], inside / 0.02, atol=1e-9)


def test_after_a_pause_a_chunk_begins_at_the_played_velocity(tmp_path: Folder) -> None:
    bench = DriverBench(Case("joint_speed"), tmp_path)
    bench.execute()
    bench.run(1.2)
    bench.freeze(0.25)
    sent, played = len(bench.commands), bench.arm.feed
    assert played[0] > 0.1
    bench.tick()
    (_, command) = bench.commands[sent]
    assert np.max(np.abs(np.subtract(command.velocity[0], played))) <= LIMIT * 0.041  # a point later or two
    bench.until("idle")
    assert bench.last().status == "succeeded"
    assert bench.rests()
    np.testing.assert_allclose(bench.positions[-1], FAR, atol=0.005)


def test_positions_alone_are_streamed_by_joint_pose(tmp_path: Folder) -> None:
    bench = DriverBench(MOVING[2], tmp_path)
    bench.execute()
    bench.until("idle")
    chunks = [command for _, command in bench.commands if command.time]
    assert len(chunks) > 20
    assert all(not command.velocity and not command.acceleration for command in chunks)


def test_a_streamed_robot_without_chunks_comes_to_rest(tmp_path: Folder) -> None:
    bench = DriverBench(Case("joint_speed"), tmp_path)
    bench.execute()
    bench.run(1.2)
    bench.freeze(2.0)
    assert not bench.arm.velocity.any()


def test_after_a_pause_joints_from_before_it_move_nothing(tmp_path: Folder) -> None:
    bench = DriverBench(Case("joint_speed"), tmp_path)
    bench.execute()
    bench.run(1.2)
    bench.silent = True
    bench.freeze(STALL_LIMIT + 1.0)
    stood = bench.arm.position
    bench.run(0.05)
    bench.silent = False
    bench.until("fault")
    np.testing.assert_array_equal(bench.arm.position, stood)


def test_measured_joints_keep_drift_from_adding_up(tmp_path: Folder) -> None:
    """A driver that is 5 % too slow is corrected by joint_speed; joint_trajectory, open loop, ends beside the goal."""
    ends = {}
    for name in ("joint_speed", "joint_trajectory"):
        bench = DriverBench(Case(name), tmp_path)
        play = bench.arm.play
        bench.arm.play = lambda positions, velocities, play=play: play(positions, velocities * 0.95)  # type: ignore[method-assign]
        bench.execute()
        while bench.machine.state().mode == "running":
            bench.tick()
        bench.run(1.0)
        ends[name] = float(np.max(np.abs(bench.arm.position - FAR)))
    assert ends["joint_speed"] < 0.005
    assert ends["joint_trajectory"] > 0.03
