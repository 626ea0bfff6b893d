"""The state machine and the monitor, driven tick by tick without a thread, on an arm that may misbehave."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest
from motions import HOME, ROBOT, moved, rest_to_rest

from zarm_contract.errors import Busy, Unavailable
from zarm_contract.messages import GoalState
from zarm_executor.follower import TICK, Follower
from zarm_executor.machine import STALL_LIMIT, Goal, Machine
from zarm_executor.monitor import Monitor
from zarm_executor.path import Array, Path
from zarm_executor.strategies.base import Measured, Progress, Strategy

LIMIT = np.array(ROBOT.descriptor.cspace.acceleration)
EXECUTION = ROBOT.descriptor.execution

Disturbance = Callable[[Measured], Measured | None]


class Arm(Strategy):
    """Follows exactly what is commanded, until `disturb` makes something else of what is measured."""

    name = "arm"

    def __init__(self) -> None:
        self.calls: list[str] = []
        self.follower = Follower(Path.standing(HOME), LIMIT)
        self.exact = Measured(HOME, np.zeros(6), 0.0)
        self.disturb: Disturbance = lambda measured: measured
        self.played = 1.0
        self.failure: Unavailable | None = None

    def open(self) -> None:
        self.calls.append("open")
        if self.failure is not None:
            raise self.failure

    def close(self) -> None:
        self.calls.append("close")

    def admit(self) -> None:
        pass

    def start(self, path: Path) -> None:
        self.follower = Follower(path, LIMIT)

    def stop(self) -> None:
        self.follower.target = 0.0

    def resume(self) -> None:
        self.follower.target = 1.0

    def tick(self, now: float, dt: float) -> None:
        if self.follower.settled:
            self.exact = Measured(self.exact.position, np.zeros(6), now)
        else:
            self.follower.advance(dt * self.played)
            self.exact = Measured(self.follower.position, self.follower.velocity, now)

    def joint_state(self) -> Measured | None:
        return self.disturb(self.exact)

    def progress(self) -> Progress:
        return Progress(self.follower.time, self.follower.speed, self.follower.position, self.follower.finished)


@dataclass
class Bench:
    """A machine with an arm, and a clock that only tests turn."""

    arm: Arm = field(default_factory=Arm)
    now: float = 100.0

    def __post_init__(self) -> None:
        self.machine = Machine(self.arm)
        self.positions: list[Array] = []
        self.machine.tick(self.now)

    def tick(self, dt: float = TICK) -> None:
        self.now += dt
        self.machine.tick(self.now)
        self.positions.append(self.arm.exact.position)

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / TICK)):
            self.tick()

    def until(self, mode: str, patience: float = 20.0) -> None:
        for _ in range(round(patience / TICK)):
            if self.machine.state().mode == mode:
                return
            self.tick()
        raise AssertionError(f"{self.machine.state()} does not become {mode}")

    def execute(self, goal_id: str = "goal-1") -> Path:
        path = Path.of(rest_to_rest(moved(1.0, -0.5), self.arm.exact.position), ROBOT.descriptor.joints)
        self.machine.start(Goal(goal_id, None, path, Monitor(path, ROBOT.descriptor.joints, EXECUTION)))
        return path

    def statuses(self) -> list[str]:
        return [change.status for change in self.machine.changes]

    def last(self) -> GoalState:
        return self.machine.changes[-1]


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
    for hold in (bench.machine.pause, lambda: bench.machine.cancel(None, "enough")):
        with pytest.raises(Busy, match="goal-1"):
            bench.machine.admit()
        hold()
        bench.run(0.05)
    bench.until("idle")
    bench.machine.admit()


@pytest.mark.parametrize("goal_id", [None, "goal-1"], ids=["any goal", "this goal"])
def test_cancel_brings_the_robot_to_rest_on_the_path_inside_the_acceleration_limits(
    bench: Bench, goal_id: str | None
) -> None:
    path = bench.execute()
    bench.run(path.duration / 2)
    bench.machine.cancel(goal_id, "enough")
    assert bench.machine.state().mode == "stopping"
    bench.until("idle")
    assert bench.statuses() == ["accepted", "running", "stopping", "cancelled"]
    assert bench.last().problem is not None
    assert bench.last().problem.code == "cancelled"
    assert 0.5 < bench.last().progress < 1.0
    np.testing.assert_allclose(bench.arm.exact.position, path.at(bench.last().progress * path.duration)[0], atol=1e-9)
    assert np.all(np.abs(np.diff(bench.positions, 2, axis=0)) / TICK**2 <= LIMIT * 1.005)


def test_cancelling_another_goal_or_a_finished_one_changes_nothing(bench: Bench) -> None:
    bench.machine.cancel(None, "nothing runs")
    bench.execute()
    bench.run(0.2)
    bench.machine.cancel("goal-7", "unknown")
    assert bench.machine.state().mode == "running"
    bench.until("idle")
    bench.machine.cancel("goal-1", "finished")
    assert bench.statuses() == ["accepted", "running", "succeeded"]


def test_commands_given_twice_do_what_they_do_once(bench: Bench) -> None:
    bench.execute()
    bench.run(0.5)
    for command in (bench.machine.pause, bench.machine.resume, bench.machine.pause):
        command()
        command()
        bench.run(1.5)
    assert bench.machine.state().mode == "paused"
    for _ in range(2):
        bench.machine.cancel(None, "enough")
    bench.until("idle")
    assert bench.statuses() == ["accepted", "running", "paused", "running", "paused", "stopping", "cancelled"]
    bench.machine.reset()
    bench.machine.resume()
    bench.machine.pause()
    assert bench.machine.state().mode == "idle"


def test_a_paused_goal_is_held_and_goes_on_to_its_end(bench: Bench) -> None:
    path = bench.execute()
    bench.run(path.duration / 2)
    bench.machine.pause()
    assert bench.machine.state().mode == "stopping"
    bench.until("paused")
    held, elapsed = bench.arm.exact.position, bench.machine.goal_state().elapsed
    bench.run(30.0)
    np.testing.assert_array_equal(bench.arm.exact.position, held)
    assert bench.machine.goal_state().elapsed == elapsed
    bench.machine.resume()
    assert bench.machine.state().mode == "running"
    bench.until("idle")
    assert bench.statuses() == ["accepted", "running", "paused", "running", "succeeded"]
    assert np.all(np.abs(np.diff(bench.positions, 2, axis=0)) / TICK**2 <= LIMIT * 1.005)


def test_going_on_while_still_braking_for_a_pause_is_smooth(bench: Bench) -> None:
    path = bench.execute()
    bench.run(path.duration / 2)
    bench.machine.pause()
    bench.run(0.2)
    bench.machine.resume()
    bench.until("idle")
    assert bench.statuses() == ["accepted", "running", "succeeded"]
    assert np.all(np.abs(np.diff(bench.positions, 2, axis=0)) / TICK**2 <= LIMIT * 1.005)


def test_a_paused_goal_can_be_cancelled(bench: Bench) -> None:
    bench.execute()
    bench.run(0.5)
    bench.machine.pause()
    bench.until("paused")
    bench.machine.cancel(None, "enough")
    bench.until("idle")
    assert bench.last().status == "cancelled"


@pytest.mark.parametrize("paused", [False, True], ids=["while it runs", "while it brakes for a pause"])
def test_a_goal_cancelled_does_not_go_on(bench: Bench, paused: bool) -> None:
    bench.execute()
    bench.run(0.5)
    if paused:
        bench.machine.pause()
    bench.machine.cancel(None, "enough")
    for command in (bench.machine.resume, bench.machine.pause, bench.machine.resume):
        command()
        bench.tick()
        assert bench.machine.state().mode == "stopping"
    bench.until("idle")
    assert bench.last().status == "cancelled"
    assert bench.last().progress < 0.7


def test_a_goal_cancelled_before_its_first_tick_does_not_move(bench: Bench) -> None:
    bench.execute()
    bench.machine.cancel(None, "never mind")
    bench.until("idle")
    assert bench.statuses() == ["accepted", "stopping", "cancelled"]
    np.testing.assert_allclose(bench.arm.exact.position, HOME, atol=1e-6)


# --- faults ---


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
    bench.machine.cancel(None, "no way out")
    bench.machine.resume()
    assert bench.machine.state().mode == "fault"
    bench.machine.reset()
    assert bench.machine.state().mode == "idle"
    assert bench.machine.state().problem is None
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
    fails(bench, "driver_stalled", "has not reported its joints")


def test_a_robot_that_never_reported_is_stopped_in_fault(bench: Bench) -> None:
    bench.execute()
    bench.arm.disturb = lambda _: None
    fails(bench, "driver_stalled", "has not reported its joints")


def test_a_robot_that_stops_reporting_while_paused_is_in_fault(bench: Bench) -> None:
    bench.execute()
    bench.run(0.5)
    bench.machine.pause()
    bench.until("paused")
    bench.arm.disturb = freeze(bench.arm.exact)
    fails(bench, "driver_stalled", "has not reported its joints")


def test_a_motion_that_takes_too_long_is_stopped_in_fault(bench: Bench) -> None:
    bench.arm.played = 0.3
    bench.execute()
    fails(bench, "driver_stalled", "more than allowed")


def test_pauses_do_not_count_towards_the_allowed_duration(bench: Bench) -> None:
    bench.execute()
    for _ in range(10):
        bench.run(0.15)
        bench.machine.pause()
        bench.until("paused")
        bench.run(3.0)
        bench.machine.resume()
    bench.until("idle")
    assert bench.last().status == "succeeded"


def test_a_robot_that_ends_beside_the_goal_is_in_fault_after_the_settle_time(bench: Bench) -> None:
    path = bench.execute()
    bench.arm.disturb = lag(EXECUTION.goal_tolerance * 2)
    bench.run(path.duration + EXECUTION.settle_time * 0.9)
    assert bench.machine.state().mode == "running"
    fails(bench, "tolerance_violated", "joint_3 missed the end of the motion by 0.0200 rad")


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
    bench.machine.pause()
    bench.arm.disturb = lambda measured: dataclasses.replace(measured, velocity=measured.velocity + 0.05)
    while not bench.arm.follower.at_rest:
        bench.tick()
    bench.run(EXECUTION.settle_time * 0.9)
    bench.arm.disturb = lambda measured: measured
    bench.until("paused")
    bench.machine.resume()
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
    bench.machine.cancel(None, "enough")
    fails(bench, "tolerance_violated", "still moves at 0.05 rad/s")


def test_a_robot_that_goes_silent_while_it_stops_is_in_fault(bench: Bench) -> None:
    bench.execute()
    bench.run(0.5)
    bench.machine.cancel(None, "enough")
    bench.arm.disturb = freeze(bench.arm.exact)
    fails(bench, "driver_stalled", "no longer reports its joints")


def test_a_control_loop_that_was_away_in_motion_ends_in_fault_without_a_jump(bench: Bench) -> None:
    bench.execute()
    bench.run(0.5)
    stood = bench.arm.exact.position
    bench.tick(STALL_LIMIT + 2.0)
    np.testing.assert_array_equal(bench.arm.exact.position, stood)
    fails(bench, "driver_stalled", "control loop was away for 2.50 s")


def test_a_control_loop_that_was_away_for_a_moment_goes_on_to_the_goal(bench: Bench) -> None:
    path = bench.execute()
    bench.run(0.5)
    bench.tick(STALL_LIMIT - 0.1)
    bench.until("idle")
    assert bench.last().status == "succeeded"
    np.testing.assert_allclose(bench.arm.exact.position, path.end, atol=1e-9)


def test_a_control_loop_that_was_away_while_nothing_moved_is_no_fault(bench: Bench) -> None:
    bench.tick(60.0)
    assert bench.machine.state().mode == "idle"
    bench.execute()
    bench.run(0.5)
    bench.machine.pause()
    bench.until("paused")
    bench.tick(60.0)
    assert bench.machine.state().mode == "paused"


def test_ticks_left_out_are_counted(bench: Bench) -> None:
    bench.run(1.0)
    assert bench.machine.state().missed_ticks == 0
    bench.tick(5 * TICK)
    assert bench.machine.state().missed_ticks == 4


# --- strategies, and the end ---


def test_a_switch_while_nothing_moves_closes_the_old_strategy_and_opens_the_new_one(bench: Bench) -> None:
    other = Arm()
    other.name = "other"  # type: ignore[misc]
    bench.machine.switch(other, patience=1.0)
    assert bench.arm.calls == ["open", "close"]
    assert other.calls == ["open"]
    assert bench.machine.state().strategy == "other"


def test_a_switch_that_fails_leaves_the_old_strategy_active_and_says_so(bench: Bench) -> None:
    other = Arm()
    other.name = "other"  # type: ignore[misc]
    other.failure = Unavailable("there is no such driver")
    with pytest.raises(Unavailable, match=r"other cannot start: there is no such driver; arm is active again"):
        bench.machine.switch(other, patience=1.0)
    assert bench.arm.calls == ["open", "close", "open"]
    assert bench.machine.state().strategy == "arm"
    bench.execute()
    bench.until("idle")
    assert bench.last().status == "succeeded"


def test_a_switch_of_a_robot_that_does_not_come_to_rest_is_refused(bench: Bench) -> None:
    bench.execute()
    bench.run(0.5)
    with pytest.raises(Unavailable, match="does not come to rest; arm is still active"):
        bench.machine.switch(Arm(), patience=0.01)  # nobody ticks meanwhile
    assert bench.arm.calls == ["open"]
    bench.until("idle")
    assert bench.last().status == "cancelled"
    bench.machine.admit()


def test_a_machine_that_ends_admits_no_motion(bench: Bench) -> None:
    assert bench.machine.end(patience=1.0)
    with pytest.raises(Unavailable, match="ending"):
        bench.machine.admit()
    bench.machine.release()
    assert bench.arm.calls == ["open", "close"]
