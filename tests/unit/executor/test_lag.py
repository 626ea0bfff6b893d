"""How late a robot is, as its goals report it."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np
import pytest

from support.executor.bench import Bench
from support.trajectories import HOME
from zarm_executor.lag import Lag
from zarm_executor.strategies.base import Measured
from zarm_trajectory.follower import TICK


def late(bench: Bench, ticks: int) -> None:
    """From now on what is measured is `ticks` old, though the messages are not."""
    passed = deque([bench.arm.exact], maxlen=1 + ticks)

    def disturbed(exact: Measured) -> Measured:
        if passed[-1] is not exact:
            passed.append(exact)
        return replace(passed[0], time=exact.time)

    bench.arm.disturb = disturbed


@pytest.mark.parametrize("ticks", [0, 1, 5, 15])
def test_a_goal_reports_by_how_much_its_robot_is_late(ticks: int) -> None:
    bench = Bench()
    late(bench, ticks)
    bench.execute()
    reported = []
    while (goal := bench.machine.goal_state()) is not None and not goal.done:
        bench.tick()
        if goal.lag is not None:
            reported.append(goal.lag)
    assert len(reported) > 100
    assert np.median(reported) == pytest.approx(ticks * TICK, abs=0.001)
    assert max(reported) < ticks * TICK + 0.02


def test_a_joint_state_that_took_long_is_no_lag() -> None:
    lag, velocity = Lag(), np.full(6, 0.5)
    for k in range(60):
        now = k * TICK
        lag.observe(now, TICK, HOME + velocity * now, Measured(HOME + velocity * (now - 0.04), velocity, now - 0.04))
    assert lag.seconds == pytest.approx(0.0, abs=1e-9)


def test_at_rest_there_is_no_lag_however_far_the_arm_sags() -> None:
    lag = Lag()
    for k in range(60):
        lag.observe(k * TICK, TICK, HOME, Measured(HOME - 0.05, np.zeros(6), k * TICK))
    assert lag.seconds is None
