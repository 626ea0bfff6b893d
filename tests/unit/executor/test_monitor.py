"""What goes wrong while a robot moves ends at rest, in fault, with the goal aborted and the reason named."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from support.arrivals import arrival
from support.executor.bench import EXECUTION, Bench, Disturbance
from support.trajectories import HOME, ROBOT, moved
from zarm_contract.errors import Unavailable
from zarm_executor.machine import STALL_LIMIT
from zarm_executor.monitor import BRAKING
from zarm_executor.strategies.base import Measured
from zarm_trajectory.follower import TICK


@pytest.fixture
def bench() -> Bench:
    return Bench()


def lag(behind: float) -> Disturbance:
    return lambda measured: dataclasses.replace(measured, position=measured.position - moved(0.0, 0.0, behind) + HOME)


def freeze(measured: Measured) -> Disturbance:
    return lambda _: measured


def fails(bench: Bench, code: str, match: str) -> None:
    """Hold what a violation leads to: rest, an aborted goal, a fault that only reset clears."""
    bench.until("fault")
    assert bench.statuses()[-2:] == ["stopping", "aborted"]
    problem = bench.machine.state().problem
    assert problem is not None
    assert problem == bench.last().problem
    assert problem.code == code
    assert match in problem.message
    assert bench.arm.follower.at_rest
    rested = bench.arm.exact.position
    bench.run(1.0)
    np.testing.assert_array_equal(bench.arm.exact.position, rested)
    with pytest.raises(Unavailable, match="executor/reset"):
        bench.machine.admit()
    bench.machine.cancel(None, "no way out", arrival())
    bench.machine.resume(arrival())
    assert bench.machine.state().mode == "fault"
    bench.machine.reset(arrival())
    assert bench.machine.state().mode == "idle"
    assert bench.machine.state().problem is None
    bench.machine.admit()


def forgiving() -> Bench:
    """Of a robot whose descriptor lets the next goal leave a fault."""
    execution = EXECUTION.model_copy(update={"faults": "clear_at_rest"})
    return Bench(robot=ROBOT.descriptor.model_copy(update={"execution": execution}))


def test_clear_at_rest_lets_the_next_goal_leave_a_fault() -> None:
    bench = forgiving()
    bench.execute()
    bench.run(0.5)
    bench.arm.disturb = freeze(bench.arm.exact)
    bench.until("fault")
    with pytest.raises(Unavailable, match=r"no new joints.* the next goal leaves this fault, once the robot rests"):
        bench.machine.admit()
    bench.arm.disturb = lambda measured: dataclasses.replace(measured, velocity=measured.velocity + 0.1)
    bench.tick()
    with pytest.raises(Unavailable, match="in fault"):
        bench.machine.admit()
    bench.arm.disturb = lambda measured: measured
    bench.tick()
    bench.machine.admit()
    assert bench.machine.state().mode == "fault"  # what is only asked leaves nothing
    bench.execute("goal-2")
    assert (bench.machine.state().mode, bench.machine.state().problem) == ("running", None)
    bench.until("idle")
    assert bench.last().status == "succeeded"


def test_a_robot_that_did_not_stop_always_needs_a_reset() -> None:
    bench = forgiving()
    bench.execute()
    bench.run(0.5)
    bench.arm.disturb = lambda measured: dataclasses.replace(measured, velocity=np.full(6, 0.1))
    bench.machine.stop("enough", arrival())
    bench.until("fault")
    bench.arm.disturb = lambda measured: measured
    bench.run(1.0)
    with pytest.raises(Unavailable, match=r"joint_1 still moves at 0.1 rad/s.*, then reset \(executor/reset\)$"):
        bench.machine.admit()
    bench.machine.reset(arrival())
    bench.machine.admit()


def test_a_robot_that_leaves_the_path_is_stopped_in_fault(bench: Bench) -> None:
    bench.execute()
    bench.run(0.5)
    bench.arm.disturb = lag(EXECUTION.path_tolerance * 1.1)
    fails(bench, "tolerance_violated", "joint_3 left the commanded path by 0.2200 rad")


def test_a_robot_that_jumps_is_stopped_in_fault(bench: Bench) -> None:
    bench.execute()
    bench.run(0.5)
    bench.arm.disturb = lambda measured: dataclasses.replace(measured, position=measured.position + 1.0)
    bench.tick()
    bench.arm.disturb = lambda measured: measured
    fails(bench, "tolerance_violated", "left the commanded path by 1.0000 rad")


def test_a_robot_that_stands_in_motion_is_stopped_in_fault(bench: Bench) -> None:
    bench.execute()
    bench.run(0.5)
    stood = bench.arm.exact
    bench.arm.disturb = lambda measured: dataclasses.replace(stood, velocity=np.zeros(6), time=measured.time)
    fails(bench, "tolerance_violated", "left the commanded path")


def test_a_robot_that_no_longer_reports_is_stopped_in_fault(bench: Bench) -> None:
    bench.execute()
    bench.run(0.5)
    bench.arm.disturb = freeze(bench.arm.exact)
    fails(bench, "driver_stalled", "has reported no new joints")


def test_joints_back_within_the_hold_timeout_resume_the_goal(bench: Bench) -> None:
    bench.execute()
    bench.run(0.5)
    for seconds in (0.35, 0.8, EXECUTION.joint_state_timeout + EXECUTION.hold_timeout - 2 * TICK):
        bench.arm.disturb = freeze(bench.arm.exact)
        bench.run(seconds)
        assert bench.machine.state().mode == "running"
        bench.arm.disturb = lambda measured: measured
        bench.tick()
    bench.until("idle")
    assert bench.statuses() == ["accepted", "running", "succeeded"]


def test_no_goal_is_reached_by_joints_that_are_old(bench: Bench) -> None:
    path = bench.execute()
    bench.run(path.duration - 0.2)
    rests = dataclasses.replace(bench.arm.exact, position=path.end, velocity=np.zeros(6))
    bench.arm.disturb = freeze(rests)
    bench.run(EXECUTION.joint_state_timeout + 0.5)
    assert bench.machine.state().mode == "running"


def test_a_robot_that_never_reported_is_stopped_in_fault(bench: Bench) -> None:
    bench.execute()
    bench.arm.disturb = lambda _: None
    fails(bench, "driver_stalled", "has reported no new joints")


def test_a_robot_that_stops_reporting_while_paused_is_in_fault(bench: Bench) -> None:
    bench.execute()
    bench.run(0.5)
    bench.machine.pause(arrival())
    bench.until("paused")
    bench.arm.disturb = freeze(bench.arm.exact)
    fails(bench, "driver_stalled", "has reported no new joints")


def test_a_motion_that_takes_too_long_is_stopped_in_fault(bench: Bench) -> None:
    bench.arm.played = 0.03
    bench.execute()
    bench.until("stopping", patience=120.0)
    bench.arm.played = 1.0
    fails(bench, "driver_stalled", "more than allowed")


def test_a_slow_driver_that_progresses_is_waited_for(bench: Bench) -> None:
    """A UR whose speed slider is down plays every trajectory slower; its users expect it to reach the goal."""
    bench.arm.played = 0.06
    bench.execute()
    bench.until("idle", patience=120.0)
    assert bench.last().status == "succeeded"


def test_a_driver_without_progress_is_stopped_in_fault_early(bench: Bench) -> None:
    bench.execute()
    bench.run(0.5)
    bench.arm.played = 0.0
    bench.run(EXECUTION.progress_timeout * 0.9)
    assert bench.machine.state().mode == "running"
    bench.until("stopping", patience=EXECUTION.progress_timeout * 0.2)
    bench.arm.played = 1.0
    fails(bench, "driver_stalled", "progress_timeout 1 s")


def test_pauses_do_not_count_towards_the_allowed_duration(bench: Bench) -> None:
    bench.execute()
    for _ in range(10):
        bench.run(0.15)
        bench.machine.pause(arrival())
        bench.until("paused")
        bench.run(3.0)
        bench.machine.resume(arrival())
    bench.until("idle")
    assert bench.last().status == "succeeded"


def test_rest_beside_the_goal_after_settling_is_a_miss_no_fault(bench: Bench) -> None:
    path = bench.execute()
    bench.arm.disturb = lag(EXECUTION.goal_tolerance * 2)
    bench.run(path.duration + EXECUTION.settle_time * 0.9)
    assert bench.machine.state().mode == "running"
    bench.until("idle")
    problem = bench.last().problem
    assert (bench.last().status, problem and problem.code) == ("aborted", "tolerance_violated")
    assert problem is not None
    assert "joint_3 missed the end of the motion by 0.0200 rad" in problem.message
    assert "plan again" in problem.message
    assert bench.machine.state().problem is None
    bench.machine.admit()


def test_motion_beside_the_goal_after_settling_is_a_fault(bench: Bench) -> None:
    path = bench.execute()
    bench.run(path.duration - 0.5)
    bench.arm.disturb = lambda measured: dataclasses.replace(
        lag(EXECUTION.goal_tolerance * 2)(measured), velocity=measured.velocity + 0.05
    )
    fails(bench, "tolerance_violated", "still moves at 0.05 rad/s")


def test_a_robot_that_settles_in_time_has_succeeded(bench: Bench) -> None:
    path = bench.execute()
    bench.arm.disturb = lag(EXECUTION.goal_tolerance * 2)
    bench.run(path.duration + EXECUTION.settle_time * 0.9)
    bench.arm.disturb = lambda measured: measured
    bench.until("idle")
    assert bench.last().status == "succeeded"


def test_each_rest_has_a_settle_time_of_its_own(bench: Bench) -> None:
    bench.execute()
    bench.run(0.5)
    bench.machine.pause(arrival())
    bench.arm.disturb = lambda measured: dataclasses.replace(measured, velocity=measured.velocity + 0.05)
    while not bench.arm.follower.at_rest:
        bench.tick()
    bench.run(EXECUTION.settle_time * 0.9)
    bench.arm.disturb = lambda measured: measured
    bench.until("paused")
    bench.machine.resume(arrival())
    bench.arm.disturb = lag(EXECUTION.goal_tolerance * 2)
    while not bench.arm.follower.finished:
        bench.tick()
    bench.run(EXECUTION.settle_time * 0.9)
    bench.arm.disturb = lambda measured: measured
    bench.until("idle")
    assert bench.last().status == "succeeded"


def test_a_robot_that_keeps_moving_after_a_stop_is_in_fault(bench: Bench) -> None:
    bench.execute()
    bench.run(0.5)
    bench.arm.disturb = lambda measured: dataclasses.replace(measured, velocity=measured.velocity + 0.05)
    bench.machine.cancel(None, "enough", arrival())
    fails(bench, "tolerance_violated", "still moves at 0.05 rad/s")


def test_rest_elsewhere_after_a_stop_is_a_fault(bench: Bench) -> None:
    bench.execute()
    bench.run(0.5)
    bench.machine.cancel(None, "enough", arrival())
    bench.arm.disturb = lag(EXECUTION.path_tolerance * 1.5)
    fails(bench, "tolerance_violated", "joint_3 left the commanded path by 0.3000 rad")


def test_a_robot_that_goes_silent_while_it_stops_is_in_fault(bench: Bench) -> None:
    bench.execute()
    bench.run(0.5)
    bench.machine.cancel(None, "enough", arrival())
    bench.arm.disturb = freeze(bench.arm.exact)
    fails(bench, "driver_stalled", "no longer reports its joints")


STOPPED_BY = BRAKING * (1.2 / 1.0 + 1.0 / 500.0) + 0.06 + EXECUTION.settle_time
"""The longest time, s, from a stop to the end of the goal: braking from 1.2 rad/s at 1 rad/s^2 and 500 rad/s^3, delay, settle time; no whole
number of ticks."""


@pytest.mark.parametrize("how", ["cancel", "pause", "violation"])
def test_a_stopped_goal_ends_in_a_stated_time_in_any_case(bench: Bench, how: str) -> None:
    bench.machine.set_speed(0.05)
    bench.execute()
    bench.run(0.5)
    bench.arm.deaf = True
    if how == "violation":
        bench.arm.disturb = lambda measured: dataclasses.replace(measured, position=measured.position + 1.0)
        bench.tick()
    else:
        bench.machine.pause(arrival()) if how == "pause" else bench.machine.cancel(None, "enough", arrival())
    bench.run(STOPPED_BY - 2 * TICK)
    assert bench.machine.state().mode == "stopping"
    bench.until("fault", patience=5 * TICK)
    assert bench.statuses()[-2:] == ["stopping", "aborted"]
    problem = bench.machine.state().problem
    assert problem is not None
    assert problem.code == ("tolerance_violated" if how == "violation" else "driver_stalled")
    assert "could not be stopped" in problem.message
    assert "emergency stop" in problem.message
    assert ("left the commanded path" in problem.message) == (how == "violation")
    assert bench.last().problem == problem


def test_a_long_stall_of_the_loop_ends_in_fault_without_a_jump(bench: Bench) -> None:
    bench.execute()
    bench.run(0.5)
    stood = bench.arm.exact.position
    bench.tick(STALL_LIMIT + 2.0)
    np.testing.assert_array_equal(bench.arm.exact.position, stood)
    fails(bench, "driver_stalled", f"control loop stood still for {STALL_LIMIT + 2.0:.2f} s")


def test_a_short_stall_of_the_loop_still_reaches_the_goal(bench: Bench) -> None:
    path = bench.execute()
    bench.run(0.5)
    bench.tick(STALL_LIMIT - 0.1)
    bench.until("idle")
    assert bench.last().status == "succeeded"
    np.testing.assert_allclose(bench.arm.exact.position, path.end, atol=1e-9)


def test_a_stall_of_the_loop_at_rest_is_no_fault(bench: Bench) -> None:
    bench.tick(60.0)
    assert bench.machine.state().mode == "idle"
    bench.execute()
    bench.run(0.5)
    bench.machine.pause(arrival())
    bench.until("paused")
    bench.tick(60.0)
    assert bench.machine.state().mode == "paused"


def test_ticks_left_out_are_counted(bench: Bench) -> None:
    bench.run(1.0)
    assert bench.machine.state().missed_ticks == 0
    bench.tick(5 * TICK)
    assert bench.machine.state().missed_ticks == 4


def test_a_robot_paused_by_its_own_controls_is_waited_for(bench: Bench) -> None:
    bench.execute()
    bench.run(0.5)
    bench.arm.played = bench.arm.allowed = 0.0
    bench.run(0.5 * EXECUTION.paused_timeout)
    assert bench.machine.state().mode == "running"
    bench.arm.played = bench.arm.allowed = 0.3
    bench.until("idle", patience=60.0)
    assert bench.last().status == "succeeded"


def test_a_robot_kept_paused_by_its_own_controls_is_a_fault(bench: Bench) -> None:
    bench.execute()
    bench.run(0.5)
    bench.arm.played = bench.arm.allowed = 0.0
    bench.run(EXECUTION.paused_timeout * 0.99)
    assert bench.machine.state().mode == "running"
    bench.until("stopping", patience=EXECUTION.paused_timeout * 0.02)
    bench.arm.played = bench.arm.allowed = 1.0
    fails(bench, "driver_stalled", "paused_timeout 300 s")
