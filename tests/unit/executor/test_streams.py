"""Chunks that a client streams, driven tick by tick: they are followed, and a client that is late has no say any more."""

from __future__ import annotations

import numpy as np
import pytest

from support.arrivals import arrival
from support.executor.bench import LIMITS, Bench
from support.executor.waves import chunk, target
from support.trajectories import HOME
from zarm_contract.errors import Busy, ExecutionRefused
from zarm_executor.goal import Chunk
from zarm_trajectory.follower import TICK

EVERY = 5
"""Ticks from one chunk to the next."""


@pytest.fixture
def bench() -> Bench:
    return Bench()


def follow(bench: Bench, seconds: float, *, first: int = 1) -> int:
    """Stream the swinging target, a chunk every 0.05 s; returns the number of the last one."""
    sequence = first
    if first == 1:
        bench.stream(chunk(0.0))
    for tick in range(round(seconds / TICK)):
        if tick % EVERY == 0 and (tick or first > 1):
            sequence += 1
            bench.steer(sequence, bench.arm.follower.time, chunk(bench.arm.follower.time))
        bench.tick()
    return sequence


def test_chunks_are_followed_without_a_jump_and_succeed(bench: Bench) -> None:
    sequence = follow(bench, 3.0)
    assert bench.machine.state().mode == "running"
    assert bench.arm.exact.position[0] - HOME[0] == pytest.approx(target(bench.arm.follower.time)[0], abs=1e-3)
    assert bench.machine.sequence("stream-1") == sequence
    now = bench.arm.follower.time
    bench.steer(sequence + 1, now, chunk(now), last=True)
    path = bench.arm.follower.trajectory
    bench.steer(sequence + 2, now, chunk(now))  # there is none after the last one
    assert bench.arm.follower.trajectory is path
    bench.until("idle")
    assert bench.statuses() == ["accepted", "running", "succeeded"]
    assert bench.last().progress == 1.0
    assert bench.greatest_acceleration() <= 1.015
    assert bench.machine.sequence("stream-1") is None


def test_a_late_chunk_ends_the_goal_without_a_fault(bench: Bench) -> None:
    sequence = follow(bench, 1.0)
    while bench.machine.state().mode == "running":
        bench.tick()
    late = bench.now
    bench.until("idle", patience=1.5)
    assert bench.statuses() == ["accepted", "running", "stopping", "aborted"]
    problem = bench.last().problem
    assert problem is not None
    assert problem.code == "timeout"
    assert f"chunk {sequence}" in problem.message
    received = 100.0 + (sequence - 1) * EVERY * TICK
    assert received + 0.1 < late <= received + 0.1 + 2 * TICK
    assert bench.machine.state().problem is None
    assert bench.greatest_acceleration() <= 1.015
    rested = bench.arm.exact.position
    bench.steer(sequence + 1, 1.2, chunk(1.2))
    bench.run(0.5)
    np.testing.assert_array_equal(bench.arm.exact.position, rested)
    bench.machine.admit()


def test_an_unreachable_chunk_changes_nothing_and_is_reported(bench: Bench) -> None:
    sequence = follow(bench, 1.0)
    path = bench.arm.follower.trajectory
    with pytest.raises(ExecutionRefused):
        bench.steer(sequence + 1, bench.arm.follower.time, chunk(1.0, off=0.5))
    assert bench.arm.follower.trajectory is path
    assert bench.machine.sequence("stream-1") == sequence


@pytest.mark.parametrize("held", [0.3, 3.0])
def test_a_stream_that_is_held_has_all_the_time_and_goes_on(bench: Bench, held: float) -> None:
    sequence = follow(bench, 1.0)
    bench.machine.pause(arrival())
    bench.until("paused")
    bench.run(held)
    assert bench.machine.state().mode == "paused"
    bench.machine.resume(arrival())
    follow(bench, 1.0, first=sequence)
    assert bench.machine.state().mode == "running"
    bench.machine.cancel(None, "enough", arrival())
    bench.until("idle", patience=1.5)
    assert bench.last().status == "cancelled"
    assert bench.greatest_acceleration() <= 1.015


def test_the_time_of_a_stream_runs_as_the_robot_moves(bench: Bench) -> None:
    bench.machine.set_speed(0.5)
    follow(bench, 2.0)
    assert bench.arm.follower.time == pytest.approx(1.0, abs=2 * TICK)
    assert bench.machine.state().mode == "running"
    state = bench.machine.goal_state()
    assert state is not None
    assert state.progress * state.duration == pytest.approx(bench.arm.follower.time)


def test_a_stream_runs_alone_and_follows_its_own_chunks(bench: Bench) -> None:
    follow(bench, 0.5)
    with pytest.raises(Busy, match="stream-1"):
        bench.machine.admit()
    path = bench.arm.follower.trajectory
    bench.machine.steer("stream-2", Chunk(9, 0.5, chunk(0.5), bench.now, 0.1, False), LIMITS)
    assert bench.arm.follower.trajectory is path


def test_a_client_slower_than_its_chunks_rests_and_goes_on(bench: Bench) -> None:
    bench.stream(chunk(0.0, 0.1, 0.5), deadline=1.0)
    while not bench.arm.follower.finished:
        bench.tick()
    bench.tick()
    assert bench.machine.state().mode == "running"
    begun = bench.arm.follower.trajectory.end
    further = chunk(0.0, 0.1, 0.5).shifted(begun - HOME)
    bench.steer(2, bench.arm.follower.time, further, last=True)
    bench.until("idle")
    assert bench.last().status == "succeeded"
    np.testing.assert_allclose(bench.arm.exact.position, further.end, atol=1e-9)
    assert bench.greatest_acceleration() <= 1.015
    assert bench.arm.exact.position[0] > begun[0]
