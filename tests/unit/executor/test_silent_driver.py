"""A driver that tells no joints for a while holds the motion, whatever the strategy; one that stays silent is a fault."""

from __future__ import annotations

from pathlib import Path as Folder

import numpy as np
import pytest

from support.arrivals import arrival
from support.executor.driven import FAR
from support.executor.driver_bench import MOVING, DriverBench, distance_from
from support.tiers import sampled
from support.trajectories import HOME, trapezoid
from zarm_simulated_driver.player import CEILING

BY_ITSELF = 0.06
"""How far (rad) an arm may leave its path that brakes by itself, each joint for itself."""


CASES = sampled(MOVING[1], MOVING[2]) + sampled(*MOVING[3:])
"""Of the strategies that send a driver chunks, and of those that hand it a whole motion, which it plays on by itself."""


@pytest.fixture(params=CASES, ids=str)
def bench(request: pytest.FixtureRequest, tmp_path: Folder) -> DriverBench:
    return DriverBench(request.param, tmp_path, ceiling=1000.0)


def given_up_after(bench: DriverBench) -> float:
    """How long (s) a driver is silent that ends a goal in fault."""
    execution = bench.robot.descriptor.execution
    return execution.joint_state_timeout + execution.hold_timeout


def silent_for(bench: DriverBench, seconds: float) -> None:
    """Let the driver tell nothing for so long; meanwhile it is sent stops alone."""
    begin, bench.silent = bench.now, True
    bench.run(seconds)
    bench.silent = False
    unheard = [command for moment, command in bench.commands if begin + 0.12 < moment < bench.now]
    assert all(not command.time for command in unheard)


@pytest.mark.lengthy
@pytest.mark.parametrize("after", sampled(0.9, 0.05, 1.7))
@pytest.mark.parametrize("seconds", sampled(0.8, 0.35))
def test_a_gap_in_joint_states_holds_and_resumes_the_motion(bench: DriverBench, after: float, seconds: float) -> None:
    path = bench.execute(timed=trapezoid)
    bench.run(after)
    silent_for(bench, seconds)
    assert bench.machine.state().mode == "running"
    bench.until("idle")
    assert bench.statuses() == ["accepted", "running", "succeeded"]
    assert bench.rests()
    np.testing.assert_allclose(bench.arm.position, FAR, atol=0.005)
    off = max(distance_from(path, position) for position, _ in bench.truth[::5])
    assert off <= (BY_ITSELF if bench.case.strategy == "joint_trajectory" else 0.005)
    assert bench.acceleration() <= CEILING * 1.01


@pytest.mark.lengthy
def test_several_gaps_in_one_motion_are_held(bench: DriverBench) -> None:
    bench.execute()
    for _ in range(3):
        bench.run(0.5)
        silent_for(bench, 0.35)
    bench.until("idle")
    assert bench.last().status == "succeeded"
    np.testing.assert_allclose(bench.arm.position, FAR, atol=0.005)


def test_a_longer_gap_is_a_fault_and_nothing_moves_after_it(bench: DriverBench) -> None:
    bench.execute()
    bench.run(0.9)
    silent_for(bench, given_up_after(bench) + 0.05)
    bench.until("fault", patience=4.0)
    problem = bench.last().problem
    assert problem is not None
    assert (bench.last().status, problem.code) == ("aborted", "driver_stalled")
    assert "hold_timeout" in problem.message
    where = bench.arm.position
    bench.machine.reset(arrival())
    bench.run(1.0)
    np.testing.assert_allclose(bench.arm.position, where, atol=1e-4)


def test_a_goal_that_is_cancelled_in_a_gap_does_not_go_on(bench: DriverBench) -> None:
    bench.execute()
    bench.run(0.9)
    bench.silent = True
    bench.run(0.3)
    bench.machine.cancel(None, "enough", arrival())
    bench.run(0.3)
    bench.silent = False
    bench.until("idle", patience=4.0)
    assert bench.last().status == "cancelled"
    assert bench.rests()
    assert np.max(np.abs(bench.arm.position - FAR)) > 0.05


def test_a_goal_paused_in_a_gap_is_held_until_resumed(bench: DriverBench) -> None:
    bench.execute()
    bench.run(0.9)
    bench.silent = True
    bench.run(0.3)
    bench.machine.pause(arrival())
    bench.run(0.3)
    bench.silent = False
    bench.until("paused", patience=4.0)
    assert bench.rests()
    bench.machine.resume(arrival())
    bench.until("idle")
    assert bench.statuses() == ["accepted", "running", "paused", "running", "succeeded"]
    np.testing.assert_allclose(bench.arm.position, FAR, atol=0.005)


@pytest.mark.lengthy
def test_a_paused_goal_needs_a_resume_after_a_gap(bench: DriverBench) -> None:
    bench.execute()
    bench.run(0.9)
    bench.machine.pause(arrival())
    bench.until("paused", patience=4.0)
    silent_for(bench, 0.8)
    assert bench.rests()
    assert bench.machine.state().mode == "paused"
    bench.machine.resume(arrival())
    bench.until("idle")
    assert bench.last().status == "succeeded"


def test_an_arm_at_its_goal_is_not_moved_back_there_after_a_gap(bench: DriverBench) -> None:
    """Somebody may have moved it by hand while its driver was away."""
    bench.execute()
    bench.until("idle")
    assert bench.rests()
    sent = len(bench.commands)
    silent_for(bench, 0.8)
    bench.arm.position = HOME.copy()
    bench.run(2.0)
    assert not any(command.time for _, command in bench.commands[sent:])


@pytest.mark.parametrize("seconds", sampled(0.9, 0.35))
def test_a_stall_beside_a_silent_driver_still_reaches_the_goal(bench: DriverBench, seconds: float) -> None:
    bench.execute()
    bench.run(0.9)
    bench.silent = True
    bench.freeze(seconds)
    bench.run(0.3)
    bench.silent = False
    bench.until("idle")
    assert bench.last().status == "succeeded"
    np.testing.assert_allclose(bench.arm.position, FAR, atol=0.005)
