"""A goal that takes the place of the one that runs, when it is asked to."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from support.executor.client import Client
from support.harness import eventually
from support.tiers import sampled
from support.trajectories import HOME, KEYS, moved, rest_to_rest
from zarm_contract.errors import Busy, Cancelled, ExecutionRefused, InvalidRequest

FAR = rest_to_rest(moved(1.5, -0.5))


def test_a_paused_goal_is_preempted_from_where_it_rests(shared: Client) -> None:
    first = shared.execute(FAR)
    shared.under_way(first)
    shared.command(KEYS.pause)
    shared.mode("paused")
    second = shared.execute(rest_to_rest(HOME, shared.position()), preempt=True)
    assert shared.ended(second).status == "succeeded"
    end = shared.goal(first)
    assert end.status == "cancelled"
    assert second in end.problem.message
    np.testing.assert_allclose(shared.position(), HOME, atol=1e-9)


@pytest.mark.slow  # as whoever gives a name twice, in test_goals.py
def test_a_goal_cannot_preempt_itself(shared: Client) -> None:
    running = shared.execute(FAR, goal_id="mine")
    shared.under_way(running)
    with pytest.raises(InvalidRequest) as refusal:
        shared.execute(FAR, preempt=True, goal_id="mine")
    assert refusal.value.problem.field == "goal_id"
    assert shared.goal(running).status == "running"
    assert shared.ended(running).status == "succeeded"
    assert shared.statuses(running) == ["accepted", "running", "succeeded"]


def test_a_preempting_motion_must_start_where_the_robot_stops(
    shared: Client,
) -> None:
    first = shared.execute(FAR)
    shared.under_way(first)
    with pytest.raises(ExecutionRefused) as refusal:
        shared.execute(FAR, preempt=True)
    assert refusal.value.code == "start_state_mismatch"
    assert shared.goal(first).status == "cancelled"
    assert shared.stands()
    assert shared.greatest_acceleration() <= 1.02
    assert shared.state().mode == "idle"


@pytest.mark.slow
def test_a_motion_outside_the_limits_does_not_preempt(shared: Client) -> None:
    first = shared.execute(FAR)
    shared.under_way(first)
    with pytest.raises(ExecutionRefused) as refusal:
        shared.execute(rest_to_rest(moved(1.0), slower=0.5), preempt=True)
    assert refusal.value.code == "limit_violated"
    assert shared.ended(first).status == "succeeded"
    assert shared.statuses(first) == ["accepted", "running", "succeeded"]


@pytest.mark.slow
def test_where_nothing_runs_it_is_an_ordinary_execution(shared: Client) -> None:
    assert shared.ended(shared.execute(FAR, preempt=True)).status == "succeeded"


@pytest.mark.parametrize("then", sampled("a stop", "a second one", "a switch"))
def test_what_comes_while_the_robot_brakes_for_another_goal(client: Client, then: str) -> None:
    first = client.execute(FAR)
    client.under_way(first)
    with ThreadPoolExecutor(1) as pool:
        waiting = pool.submit(client.execute, FAR, preempt=True)
        eventually(lambda: client.goal(first).status == "stopping", "the first goal is stopping")
        if then == "a second one":
            with pytest.raises(Busy):
                client.execute(FAR, preempt=True)
            with pytest.raises(ExecutionRefused):  # as it does not start where the robot rests
                waiting.result()
        else:
            client.strategy("ghost") if then == "a switch" else client.command(KEYS.stop)
            with pytest.raises(Cancelled):
                waiting.result()
    assert client.ended(first).status == "cancelled"
    assert client.state().mode == "idle"
    assert client.stands()
