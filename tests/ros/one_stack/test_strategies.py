"""set_robot_strategy by both of its types, and what tells of strategies."""

from __future__ import annotations

from collections.abc import Iterator
from threading import Barrier, Thread

import pytest
from rclpy.node import Node
from std_srvs.srv import Trigger

from curobo_msgs.srv import GetRobotStrategies, SetRobotStrategy
from support.harness import PATIENCE, eventually
from support.ros.client import robot_type
from support.ros.node import running_node
from support.ros.stack import KEYS, RosClient, Stack
from zarm_contract.messages import StrategyRequest


@pytest.fixture(scope="module")
def first_node(running: Stack) -> Iterator[Node]:
    """Of a client of version 1: DDS knows one type of a service in each participant."""
    with running_node("client_v1") as node:
        yield node


@pytest.fixture
def first(running: Stack, first_node: Node) -> RosClient:
    running.bus.call(KEYS.strategy, StrategyRequest(strategy="emulator"), timeout=20)
    eventually(lambda: robot_type(first_node) == "emulator", "robot_type follows")
    return RosClient(first_node)


def active(running: Stack) -> str:
    return running.bus.call(KEYS.strategy, StrategyRequest(), timeout=10).active


def test_version_2_switches_by_name_and_tells_both_names(running: Stack, first: RosClient) -> None:
    answered = running.ros.call(SetRobotStrategy, "set_robot_strategy", robot_strategy="ghost")
    assert (answered.success, answered.message) == (True, "Strategy switched from 'emulator' to 'ghost'")
    assert (answered.previous_robot_strategy, answered.current_robot_strategy) == ("emulator", "ghost")
    assert active(running) == "ghost"


def test_version_2_refuses_with_the_executor_s_reason(running: Stack, first: RosClient) -> None:
    for name, reason in (("joint_speed", "driver"), ("nothing_like_it", "there is no strategy"), ("", "no strategy")):
        answered = running.ros.call(SetRobotStrategy, "set_robot_strategy", robot_strategy=name)
        assert not answered.success
        assert reason in answered.message
        assert (answered.previous_robot_strategy, answered.current_robot_strategy) == ("emulator", "emulator")
    assert active(running) == "emulator"


def test_version_1_switches_to_what_robot_type_says(running: Stack, first: RosClient) -> None:
    assert robot_type(first.node, "ghost") == "ghost"
    assert active(running) == "emulator"
    answered = first.call(Trigger, "set_robot_strategy")
    assert (answered.success, answered.message) == (True, "Strategy switched from 'emulator' to 'ghost'")
    assert active(running) == "ghost"
    robot_type(first.node, "emulator")
    assert first.call(Trigger, "set_robot_strategy").message == "Strategy switched from 'ghost' to 'emulator'"


def test_version_1_fails_and_keeps_robot_type(running: Stack, first: RosClient) -> None:
    robot_type(first.node, "doosan_m1013")
    answered = first.call(Trigger, "set_robot_strategy")
    assert not answered.success
    assert "joint_trajectory cannot start" in answered.message
    assert robot_type(first.node) == "emulator"
    assert active(running) == "emulator"


def test_both_versions_are_served_at_the_same_time(running: Stack, first: RosClient) -> None:
    together = Barrier(2)
    answers: list[object] = []

    def ask(client: RosClient, kind: object, **request: str) -> None:
        for _ in range(20):
            together.wait(PATIENCE)
            answers.append(client.call(kind, "set_robot_strategy", **request))

    one = Thread(target=ask, args=(running.ros, SetRobotStrategy), kwargs={"robot_strategy": "emulator"})
    other = Thread(target=ask, args=(first, Trigger))
    for thread in (one, other):
        thread.start()
    for thread in (one, other):
        thread.join()
    assert len(answers) == 40
    assert all(answered.success for answered in answers)  # type: ignore[attr-defined]


def test_the_strategies_are_listed_with_the_active_one(running: Stack, first: RosClient) -> None:
    report = running.ros.call(GetRobotStrategies, "get_robot_strategies")
    assert report.success
    assert set(report.strategy_names) == {"emulator", "ghost", "joint_speed", "joint_pose", "joint_trajectory"}
    assert list(report.strategy_ids) == list(range(5))
    assert report.current_strategy_name == report.strategy_names[report.current_strategy_id] == "emulator"
    answered = running.ros.call(Trigger, "get_robot_strategy")
    assert (answered.success, answered.message) == (True, "emulator")
