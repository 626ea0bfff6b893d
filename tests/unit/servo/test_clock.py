"""How far a stream is commanded is known within what the executor tells of it."""

from __future__ import annotations

import pytest

from zarm_contract.messages import GoalState, GoalStatus
from zarm_servo.tracking.clock import StepTimes, StreamClock


def goal(time: float, status: GoalStatus = "running") -> GoalState:
    return GoalState(
        goal_id="jog", status=status, progress=time / 2.0, elapsed=time, duration=2.0, joint_command=(0.0, 0.0)
    )


def test_it_follows_the_stream_s_speed_and_holds() -> None:
    clock = StreamClock(0.0)
    assert clock.time(5.0) == 0.0
    clock.receive(goal(0.0), 5.0)
    assert clock.time(5.38) == pytest.approx(0.4)
    clock.set_speed(0.5, 5.38)
    assert clock.time(5.78) == pytest.approx(0.6)
    clock.receive(goal(0.6, "stopping"), 5.78)
    assert clock.time(9.0) == pytest.approx(0.6)


def test_reports_correct_it_and_give_the_lag() -> None:
    clock = StreamClock(0.2)
    clock.receive(goal(0.0), 5.0)
    clock.receive(goal(1.0), 5.5)
    assert clock.time(5.5) == pytest.approx(1.22)
    clock.receive(goal(1.05), 6.5)
    assert 1.27 < clock.time(6.5) < 1.37
    for word in range(50):
        clock.receive(goal(1.05 + 0.01 * word), 6.5 + 0.01 * word)
    assert clock.time(6.99) == pytest.approx(1.05 + 0.49 + 0.22, abs=2e-3)


def test_steps_are_evenly_apart_until_the_estimate_is_far_off() -> None:
    times = StepTimes()
    first = times.next(0.004, 10.0)
    assert first == 10.0
    assert times.next(0.004, 10.005) == pytest.approx(10.004)
    assert times.next(0.004, 10.1) == pytest.approx(10.1)


def test_a_measured_lag_is_made_up_for_up_to_a_limit() -> None:
    times, robot_lag = StepTimes(), 0.02
    for step in range(400):
        meant_for = times.next(0.004, 0.004 * step)
        times.learn(robot_lag - (meant_for - 0.004 * step))
    assert meant_for - 0.004 * step == pytest.approx(robot_lag, abs=0.003)
    for _ in range(1000):
        times.learn(1.0)
    assert times.next(0.004, 5.0) == pytest.approx(5.05)
