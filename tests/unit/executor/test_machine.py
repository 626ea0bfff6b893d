"""The state machine, driven tick by tick without a thread."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from support.arrivals import arrival
from support.executor.bench import Arm, Bench
from support.harness import PATIENCE
from support.trajectories import HOME
from zarm_contract.errors import Busy, Cancelled, Unavailable
from zarm_contract.messages import ExternalTorque
from zarm_trajectory.follower import TICK


@pytest.fixture
def bench() -> Bench:
    return Bench()


# --- modes ---


def test_a_goal_runs_to_its_end_and_the_robot_is_idle_again(bench: Bench) -> None:
    path = bench.execute()
    assert bench.machine.state().mode == "running"
    bench.until("idle")
    assert bench.statuses() == ["accepted", "running", "succeeded"]
    assert bench.last().progress == 1.0
    assert bench.last().elapsed == pytest.approx(path.duration, abs=2 * TICK)
    np.testing.assert_allclose(bench.arm.exact.position, path.end, atol=1e-9)


def test_a_second_goal_is_refused_until_the_first_has_ended(bench: Bench) -> None:
    bench.execute("goal-1")
    bench.run(0.3)
    for hold in (lambda: bench.machine.pause(arrival()), lambda: bench.machine.cancel(None, "enough", arrival())):
        with pytest.raises(Busy, match="goal-1"):
            bench.machine.admit()
        hold()
        bench.run(0.05)
    bench.until("idle")
    bench.machine.admit()


@pytest.mark.parametrize("goal_id", [None, "goal-1"], ids=["any goal", "this goal"])
def test_cancel_decelerates_on_the_path_within_limits(bench: Bench, goal_id: str | None) -> None:
    path = bench.execute()
    bench.run(path.duration / 2)
    bench.machine.cancel(goal_id, "enough", arrival())
    assert bench.machine.state().mode == "stopping"
    bench.until("idle")
    assert bench.statuses() == ["accepted", "running", "stopping", "cancelled"]
    assert bench.last().problem is not None
    assert bench.last().problem.code == "cancelled"
    assert 0.5 < bench.last().progress < 1.0
    np.testing.assert_allclose(bench.arm.exact.position, path.at(bench.last().progress * path.duration)[0], atol=1e-9)
    assert bench.greatest_acceleration() <= 1.005


def test_cancelling_another_or_a_finished_goal_changes_nothing(bench: Bench) -> None:
    bench.machine.cancel(None, "nothing runs", arrival())
    bench.execute()
    bench.run(0.2)
    bench.machine.cancel("goal-7", "unknown", arrival())
    assert bench.machine.state().mode == "running"
    bench.until("idle")
    bench.machine.cancel("goal-1", "finished", arrival())
    assert bench.statuses() == ["accepted", "running", "succeeded"]


def test_commands_given_twice_do_what_they_do_once(bench: Bench) -> None:
    bench.execute()
    bench.run(0.5)
    for command in (bench.machine.pause, bench.machine.resume, bench.machine.pause):
        command(arrival())
        command(arrival())
        bench.run(1.5)
    assert bench.machine.state().mode == "paused"
    for _ in range(2):
        bench.machine.cancel(None, "enough", arrival())
    bench.until("idle")
    assert bench.statuses() == ["accepted", "running", "paused", "running", "paused", "stopping", "cancelled"]
    bench.machine.reset(arrival())
    bench.machine.resume(arrival())
    bench.machine.pause(arrival())
    assert bench.machine.state().mode == "idle"


def test_a_paused_goal_is_held_and_goes_on_to_its_end(bench: Bench) -> None:
    path = bench.execute()
    bench.run(path.duration / 2)
    bench.machine.pause(arrival())
    assert bench.machine.state().mode == "stopping"
    bench.until("paused")
    held, elapsed = bench.arm.exact.position, bench.machine.goal_state().elapsed
    bench.run(30.0)
    np.testing.assert_array_equal(bench.arm.exact.position, held)
    assert bench.machine.goal_state().elapsed == elapsed
    bench.machine.resume(arrival())
    assert bench.machine.state().mode == "running"
    bench.until("idle")
    assert bench.statuses() == ["accepted", "running", "paused", "running", "succeeded"]
    assert bench.greatest_acceleration() <= 1.005


def test_going_on_while_still_braking_for_a_pause_is_smooth(bench: Bench) -> None:
    path = bench.execute()
    bench.run(path.duration / 2)
    bench.machine.pause(arrival())
    bench.run(0.2)
    bench.machine.resume(arrival())
    bench.until("idle")
    assert bench.statuses() == ["accepted", "running", "succeeded"]
    assert bench.greatest_acceleration() <= 1.005


def test_a_paused_goal_can_be_cancelled(bench: Bench) -> None:
    bench.execute()
    bench.run(0.5)
    bench.machine.pause(arrival())
    bench.until("paused")
    bench.machine.cancel(None, "enough", arrival())
    bench.until("idle")
    assert bench.last().status == "cancelled"


@pytest.mark.parametrize("paused", [False, True], ids=["while it runs", "while it brakes for a pause"])
def test_a_goal_cancelled_does_not_go_on(bench: Bench, paused: bool) -> None:
    bench.execute()
    bench.run(0.5)
    if paused:
        bench.machine.pause(arrival())
    bench.machine.cancel(None, "enough", arrival())
    for command in (bench.machine.resume, bench.machine.pause, bench.machine.resume):
        command(arrival())
        bench.tick()
        assert bench.machine.state().mode == "stopping"
    bench.until("idle")
    assert bench.last().status == "cancelled"
    assert bench.last().progress < 0.7


def test_a_goal_cancelled_before_its_first_tick_does_not_move(bench: Bench) -> None:
    bench.execute()
    bench.machine.cancel(None, "never mind", arrival())
    bench.until("idle")
    assert bench.statuses() == ["accepted", "stopping", "cancelled"]
    np.testing.assert_allclose(bench.arm.exact.position, HOME, atol=1e-6)


# --- speed ---


@pytest.mark.parametrize("scale", [0.05, 0.5])
def test_a_slower_motion_takes_longer_and_is_not_overdue(bench: Bench, scale: float) -> None:
    bench.machine.set_speed(scale)
    assert bench.machine.state().speed_scale == scale
    path = bench.execute()
    bench.until("idle", patience=100.0)
    assert bench.last().status == "succeeded"
    assert bench.last().duration == path.duration  # as planned
    assert bench.last().elapsed == pytest.approx(path.duration / scale, rel=0.02)


def test_speed_changes_in_motion_within_limits_and_persists(bench: Bench) -> None:
    path = bench.execute()
    for scale in (0.3, 1.0, 0.05, 0.5):
        bench.run(0.4)
        bench.machine.set_speed(scale)
    bench.until("idle")
    assert bench.statuses() == ["accepted", "running", "succeeded"]
    assert bench.last().elapsed > 1.2 * path.duration
    assert bench.greatest_acceleration() <= 1.005
    np.testing.assert_allclose(bench.arm.exact.position, path.end, atol=1e-9)
    assert bench.machine.state().speed_scale == 0.5


@pytest.mark.parametrize("scale", [0.05, 0.4, 1.0])
def test_a_goal_is_held_resumed_and_cancelled_at_every_speed(bench: Bench, scale: float) -> None:
    bench.machine.set_speed(scale)
    bench.execute()
    bench.run(0.6 / scale)
    bench.machine.pause(arrival())
    bench.until("paused", patience=2.0)
    bench.machine.resume(arrival())
    bench.run(0.3 / scale)
    bench.machine.cancel(None, "enough", arrival())
    bench.until("idle", patience=2.0)
    assert bench.statuses() == ["accepted", "running", "paused", "running", "stopping", "cancelled"]
    assert bench.greatest_acceleration() <= 1.005


def test_a_new_speed_does_not_move_what_is_held_or_ending(bench: Bench) -> None:
    bench.execute()
    bench.run(0.5)
    bench.machine.pause(arrival())
    bench.machine.set_speed(0.5)
    bench.until("paused")
    held = bench.arm.exact.position
    bench.machine.set_speed(0.7)
    bench.run(1.0)
    np.testing.assert_array_equal(bench.arm.exact.position, held)
    bench.machine.resume(arrival())
    bench.run(1.0)
    assert bench.arm.follower.speed == 0.7
    bench.machine.cancel(None, "enough", arrival())
    bench.machine.set_speed(1.0)
    bench.until("idle", patience=2.0)
    assert bench.last().status == "cancelled"


# --- preemption ---


def test_a_preempted_goal_is_cancelled_and_names_its_successor(bench: Bench) -> None:
    bench.execute()
    bench.run(0.5)
    bench.machine.admit(preempt=True)
    with ThreadPoolExecutor(1) as pool:
        preempted = pool.submit(bench.machine.preempt, "goal-2", arrival(), PATIENCE)
        while not preempted.done():
            bench.tick()
        preempted.result()
    assert bench.machine.state().mode == "idle"
    assert bench.statuses() == ["accepted", "running", "stopping", "cancelled"]
    assert bench.last().problem is not None
    assert bench.last().problem.code == "cancelled"
    assert "goal-2" in bench.last().problem.message
    assert bench.greatest_acceleration() <= 1.005


def test_nothing_is_preempted_where_nothing_could_start(bench: Bench) -> None:
    bench.execute()
    bench.run(0.5)
    bench.arm.disturb = lambda _: None
    bench.until("fault")
    with pytest.raises(Unavailable, match="fault"):
        bench.machine.admit(preempt=True)
    bench.arm.disturb = lambda measured: measured
    bench.machine.reset(arrival())
    assert bench.machine.end(PATIENCE)
    with pytest.raises(Unavailable, match="ending"):
        bench.machine.admit(preempt=True)


def test_a_goal_waiting_to_preempt_can_be_cancelled(bench: Bench) -> None:
    for goal_id in (None, "goal-2"):
        before = arrival()
        bench.machine.preempt("goal-2", before, PATIENCE)
        bench.machine.cancel(goal_id, "never mind", arrival())
        with pytest.raises(Cancelled):
            bench.execute("goal-2", asked=before)
    bench.execute("goal-3")
    bench.until("idle")
    assert bench.last().status == "succeeded"


# --- what arrived before a stop and is carried out after it ---


@pytest.mark.parametrize("hold", ["stop", "cancel", "pause"])
def test_a_motion_requested_before_a_stop_does_not_begin(bench: Bench, hold: str) -> None:
    early = arrival()
    if hold == "stop":
        bench.machine.stop("enough", arrival())
    elif hold == "cancel":
        bench.machine.cancel(None, "enough", arrival())
    else:
        bench.machine.pause(arrival())
    for command in (
        lambda: bench.execute(asked=early),
        lambda: bench.machine.preempt("goal-2", early, PATIENCE),
    ):
        with pytest.raises(Cancelled, match="came after this request"):
            command()
    bench.execute()
    bench.until("idle")
    assert bench.last().status == "succeeded"


def test_a_stop_wins_over_an_earlier_switch_a_cancel_does_not(bench: Bench) -> None:
    early, other = arrival(), Arm()
    bench.machine.cancel(None, "enough", arrival())
    bench.machine.switch(bench.arm, PATIENCE, early)
    bench.machine.stop("enough", arrival())
    with pytest.raises(Busy, match="a stop came after"):
        bench.machine.switch(other, PATIENCE, early)
    assert other.calls == []


def test_a_pause_wins_over_a_resume_that_arrived_before_it(bench: Bench) -> None:
    bench.execute()
    bench.run(0.5)
    bench.machine.pause(arrival())
    early = arrival()
    bench.machine.pause(arrival())
    bench.machine.resume(early)
    bench.until("paused")
    bench.run(0.5)
    assert bench.machine.state().mode == "paused"


def test_a_stop_wins_over_a_reset_that_arrived_before_it(bench: Bench) -> None:
    bench.execute()
    bench.run(0.5)
    bench.arm.disturb = lambda _: None
    bench.until("fault")
    early = arrival()
    bench.machine.stop("enough", arrival())
    bench.machine.reset(early)
    assert bench.machine.state().mode == "fault"
    bench.machine.reset(arrival())
    assert bench.machine.state().mode == "idle"


# --- strategies, and the end ---


def test_a_switch_at_rest_closes_one_strategy_opens_the_other(bench: Bench) -> None:
    other = Arm()
    other.name = "other"  # type: ignore[misc]
    bench.machine.switch(other, 1.0, arrival())
    assert bench.arm.calls == ["open", "close"]
    assert other.calls == ["open"]
    assert bench.machine.state().strategy == "other"


def test_a_failed_switch_keeps_the_old_strategy_and_says_so(bench: Bench) -> None:
    other = Arm()
    other.name = "other"  # type: ignore[misc]
    other.failure = Unavailable("there is no such driver")
    with pytest.raises(Unavailable, match=r"other cannot start: there is no such driver; arm is active again"):
        bench.machine.switch(other, 1.0, arrival())
    assert bench.arm.calls == ["open", "close", "open"]
    assert bench.machine.state().strategy == "arm"
    bench.execute()
    bench.until("idle")
    assert bench.last().status == "succeeded"


def test_a_switch_is_refused_if_the_robot_does_not_stop(bench: Bench) -> None:
    bench.execute()
    bench.run(0.5)
    with pytest.raises(Unavailable, match="does not come to rest; arm is still active"):
        bench.machine.switch(Arm(), 0.01, arrival())  # nobody ticks meanwhile
    assert bench.arm.calls == ["open", "stop"]
    bench.until("idle")
    assert bench.last().status == "cancelled"
    bench.machine.admit()


def test_a_machine_that_ends_admits_no_motion(bench: Bench) -> None:
    assert bench.machine.end(patience=1.0)
    with pytest.raises(Unavailable, match="ending"):
        bench.machine.admit()
    bench.machine.release()
    assert bench.arm.calls == ["open", "close"]


@pytest.mark.parametrize("order", ["cancel", "switch"])
def test_a_motion_being_checked_does_not_start_after_a_stop(bench: Bench, order: str) -> None:
    before = arrival()
    if order == "cancel":
        bench.machine.cancel(None, "stop", arrival())
    else:
        bench.machine.switch(bench.arm, 1.0, arrival())
    with pytest.raises(Cancelled):
        bench.execute(asked=before)
    assert bench.machine.state().mode == "idle"
    assert not bench.machine.changes


# --- joints ---


def test_fresh_joints_are_waited_for(bench: Bench) -> None:
    stale = bench.machine.joint_state()
    assert bench.machine.wait_for_joint_state(bench.now + TICK, 0.0) == stale
    with ThreadPoolExecutor() as pool:
        fresh = pool.submit(bench.machine.wait_for_joint_state, bench.now + TICK, PATIENCE)
        bench.tick()
        measured = fresh.result(PATIENCE)
    assert measured is not None
    assert measured.time == bench.now


# --- felt collisions ---


def felt(goal_id: str, joint: str | None = "joint_2") -> ExternalTorque:
    names, torque = ("joint_1", "joint_2"), (1.0, -31.0)
    return ExternalTorque(stamp=1e9, joint_names=names, torque=torque, largest=torque, goal_id=goal_id, joint=joint)


def test_a_detected_collision_stops_the_robot_in_fault(bench: Bench) -> None:
    path = bench.execute()
    bench.run(path.duration / 2)
    for _ in range(3):
        bench.machine.collide(felt("goal-1"))
        bench.tick()
    assert bench.machine.state().mode == "stopping"
    bench.until("fault")
    problem = bench.machine.state().problem
    assert problem is not None
    assert (problem.code, problem.joint) == ("collision_detected", "joint_2")
    assert "something pushes joint_2 with 31.0 Nm" in problem.message
    bench.machine.reset(arrival())
    assert bench.machine.state().mode == "idle"


def test_torques_below_limits_or_of_another_goal_end_nothing(bench: Bench) -> None:
    bench.execute("goal-2")
    bench.run(0.3)
    bench.machine.collide(felt("goal-1"))
    bench.machine.collide(felt("goal-2", joint=None))
    bench.until("idle")
    assert bench.last().status == "succeeded"
    bench.machine.collide(felt("goal-2"))
    assert bench.machine.state().mode == "idle"
