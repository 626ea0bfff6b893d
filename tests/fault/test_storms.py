"""Whatever many clients ask at once, each is answered, one goal runs, the robot brakes once, and the next goal works."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from support.executor.driven import FAR, LIMIT, Driven, driven
from support.faults.storms import Storm, storm
from support.harness import eventually
from support.resources import favour
from support.trajectories import HOME, KEYS, ROBOT, moved, rest_to_rest
from zarm_contract.codec import decode
from zarm_contract.errors import Unavailable
from zarm_contract.messages import (
    Accepted,
    CancelRequest,
    ExecuteRequest,
    ExecutorState,
    Message,
    Nothing,
    Strategies,
    StrategyRequest,
)
from zarm_runtime.bus import Bus

pytestmark = pytest.mark.slow

THERE = rest_to_rest(FAR, slower=2.0)
SPEED = float(np.max(np.abs(THERE.velocity)))
STEP = 0.01
"""The simulated arm tells its joints once in this many seconds of its own clock."""
TOLD_WITHIN = 0.5
"""Longest time, s, from a stop to the first joint states of a braking robot, the arm's lag included."""
BOUND = round((SPEED / min(ROBOT.descriptor.cspace.acceleration) + TOLD_WITHIN) / STEP)
"""How many joint states the arm tells at most from the first cancel on until it rests."""
RIPPLE = 0.02
"""A braking robot whose joints are together faster by this (rad/s) than a moment ago has begun to move again."""
COMMANDS: tuple[tuple[str, Message], ...] = (
    (KEYS.pause, Nothing()),
    (KEYS.resume, Nothing()),
    (KEYS.reset, Nothing()),
)
"""What holds a motion and goes on with it."""
REFUSALS = ("ok", "busy", "cancelled", "unavailable", "start_state_mismatch", "no_joint_state")
"""What a request to move is answered while others stop the robot and switch its strategy."""


@pytest.fixture
def robot(bus: Bus, endpoint: str, tmp_path: Path) -> Iterator[Driven]:
    with driven(bus, endpoint, tmp_path, "joint_speed") as robot:
        favour(robot.driver, robot.executor)
        yield robot
        assert robot.commanded_acceleration() <= LIMIT * 1.01


def samples_until_rest(robot: Driven, first: int) -> int:
    """How many joint states the arm told from the one with this number on until it stood for good."""
    robot.at_rest()
    moving = [number for number, state in enumerate(robot.reported) if any(state.velocity)]
    return max(0, moving[-1] + 1 - first)


def brakes_once(robot: Driven, first: int) -> bool:
    """Whether the arm, from that joint state on, only ever became slower once it had begun to."""
    speed = np.array([np.linalg.norm(state.velocity) for state in robot.reported[first:]])
    slowest = np.minimum.accumulate(speed[int(speed.argmax()) :])
    return bool(np.all(speed[int(speed.argmax()) :] <= slowest + RIPPLE))


def test_a_thousand_cancels_are_answered_and_brake_once(robot: Driven, endpoint: str) -> None:
    with Storm(endpoint) as clients:
        goal_id = robot.client.execute(THERE)
        cancels = [CancelRequest(goal_id=goal_id if number % 2 else f"goal-{number}") for number in range(1000)]
        robot.client.under_way(goal_id)
        first = len(robot.reported)
        answers = clients.let_loose([(KEYS.cancel, cancel) for cancel in cancels])
    assert Counter(answer.code for answer in answers) == {"ok": 1000}
    assert {decode(ExecutorState, answer.reply.encode()).mode for answer in answers} <= {"running", "stopping", "idle"}
    assert robot.client.ended(goal_id).status == "cancelled"
    assert robot.client.statuses(goal_id) == ["accepted", "running", "stopping", "cancelled"]
    assert samples_until_rest(robot, first) <= BOUND
    assert brakes_once(robot, first)
    assert robot.client.state().problem is None
    robot.works_again()


def test_of_a_hundred_execute_requests_one_is_accepted(robot: Driven, endpoint: str) -> None:
    answers = storm(endpoint, [(KEYS.execute, ExecuteRequest(trajectory=THERE))] * 100)
    assert Counter(answer.code for answer in answers) == {"ok": 1, "busy": 99}
    (accepted,) = (decode(Accepted, answer.reply.encode()) for answer in answers if answer.code == "ok")
    assert robot.client.ended(accepted.goal_id).status == "succeeded"
    assert {goal.goal_id for goal in robot.client.goals} == {accepted.goal_id}
    np.testing.assert_allclose(robot.at_rest(), FAR, atol=0.005)
    robot.works_again()


@pytest.mark.parametrize("seed", [1, 2])
def test_concurrent_switches_are_answered_and_leave_one_strategy(robot: Driven, endpoint: str, seed: int) -> None:
    reported: list[Strategies] = []
    robot.bus.subscribe(KEYS.strategy, lambda _, strategies: reported.append(strategies))
    choice = random.Random(seed)
    names = ("emulator", "joint_speed", "joint_trajectory", "ghost")
    requests: list[tuple[str, Message]] = [
        (KEYS.strategy, StrategyRequest(strategy=choice.choice(names))) for _ in range(100)
    ]
    requests += [(KEYS.cancel, CancelRequest())] * 40
    requests += [(KEYS.execute, ExecuteRequest(trajectory=rest_to_rest(moved(0.3), slower=3.0)))] * 40
    choice.shuffle(requests)
    with Storm(endpoint) as clients:
        goal_id = robot.client.execute(THERE)
        robot.client.under_way(goal_id)
        answers = clients.let_loose(requests)
    robot.client.command(KEYS.stop)
    assert robot.client.ended(goal_id).status == "cancelled"
    for answer in answers:
        if answer.key == KEYS.strategy:
            assert answer.code in ("ok", "busy"), answer
        elif answer.key == KEYS.cancel:
            assert answer.code == "ok", answer
        else:
            assert answer.code in REFUSALS, answer
    assert any(answer.key == KEYS.strategy and answer.code == "ok" for answer in answers)
    state = robot.client.mode("idle")
    assert state.problem is None
    active = robot.client.strategy().active
    assert state.strategy == active
    eventually(lambda: reported and reported[-1].active == active, "the active strategy has been published last")
    robot.at_rest()
    assert robot.client.stands()
    if active == "ghost":
        with pytest.raises(Unavailable, match="switch to another one"):
            robot.client.execute(rest_to_rest(moved(0.2, start=robot.client.position()), robot.client.position()))
        active = robot.client.strategy("joint_speed").active
    start = robot.client.position()
    goal_id = robot.client.execute(rest_to_rest(moved(-0.2, start=start), start))
    assert robot.client.ended(goal_id).status == "succeeded"
    np.testing.assert_allclose(robot.client.position(), moved(-0.2, start=start), atol=0.01)
    assert robot.client.state().strategy == active
    robot.at_rest()


def test_concurrent_pauses_and_resumes_still_reach_the_goal(robot: Driven, endpoint: str) -> None:
    choice = random.Random(3)
    with Storm(endpoint) as clients:
        goal_id = robot.client.execute(THERE)
        robot.client.under_way(goal_id)
        answers = clients.let_loose([choice.choice(COMMANDS) for _ in range(600)])
    assert Counter(answer.code for answer in answers) == {"ok": 600}
    eventually(lambda: robot.client.command(KEYS.resume).mode != "paused", "the goal goes on")
    end = robot.client.ended(goal_id)
    assert end.status == "succeeded", end
    assert set(robot.client.statuses(goal_id)) <= {"accepted", "running", "paused", "succeeded"}
    np.testing.assert_allclose(robot.at_rest(), FAR, atol=0.005)
    assert robot.client.state().problem is None
    robot.works_again()


def test_a_stop_amid_pauses_and_resumes_is_the_end_of_the_goal(robot: Driven, endpoint: str) -> None:
    choice = random.Random(4)
    requests = [choice.choice(COMMANDS) for _ in range(400)]
    requests.insert(100, (KEYS.stop, Nothing()))
    with Storm(endpoint) as clients:
        goal_id = robot.client.execute(THERE)
        robot.client.under_way(goal_id)
        answers = clients.let_loose(requests)
    assert Counter(answer.code for answer in answers) == {"ok": 401}
    assert robot.client.ended(goal_id).status == "cancelled"
    stopped = robot.at_rest()
    assert np.max(np.abs(stopped - HOME)) > 0.05
    assert np.max(np.abs(stopped - FAR)) > 0.01
    robot.works_again()
