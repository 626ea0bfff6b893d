"""The lag that the servo reckons with."""

from __future__ import annotations

import pytest

from zarm_contract.messages import ExecutorState, GoalState
from zarm_servo.world.robot_lag import RobotLag


def reported(lag: float | None) -> GoalState:
    return GoalState(
        goal_id="goal-1", status="running", progress=0.5, elapsed=1.0, duration=2.0, joint_command=(0.0,), lag=lag
    )


def under(strategy: str) -> ExecutorState:
    return ExecutorState(mode="idle", strategy=strategy, speed_scale=1.0, missed_ticks=0)


def test_the_greatest_lag_of_late_counts() -> None:
    lag = RobotLag()
    assert lag.seconds == 0.0
    for seconds in (0.02, 0.08, None, 0.03):
        lag.on_goal(reported(seconds))
    assert lag.seconds == 0.08
    for _ in range(20):
        lag.on_goal(reported(0.01))
    assert lag.seconds == 0.01


def test_a_robot_that_is_ahead_may_be_so_for_a_moment_only() -> None:
    lag = RobotLag()
    lag.on_goal(reported(-0.04))
    assert lag.seconds == 0.0


def test_another_strategy_drives_the_robot_in_another_way() -> None:
    lag = RobotLag()
    lag.on_state(under("joint_speed"))
    lag.on_goal(reported(0.08))
    lag.on_state(under("joint_speed"))
    assert lag.seconds == pytest.approx(0.08)
    lag.on_state(under("joint_trajectory"))
    assert lag.seconds == 0.0
