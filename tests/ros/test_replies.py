"""A client is answered though DDS finds it late; the log tells of one that is not found, and its goal moves nothing."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial

import pytest
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_srvs.srv import Trigger

from curobo_msgs.action import SendTrajectory
from support.harness import PATIENCE, ServiceProcess, eventually
from support.ros.client import RosClient
from support.ros.goals import SUCCEEDED, Actions, Robot
from support.ros.stack import KEYS, Stack, stack
from zarm_ros_bridge.replies import insistent

ACTION = "/unified_planner/execute_trajectory"
NOT_FOUND = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""A client that asks for durability can ask, but replies are volatile, so that DDS does not bring the two together."""


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    with stack(tmp_path_factory.mktemp("replies")) as started:
        yield started


@pytest.fixture
def bridge(running: Stack) -> ServiceProcess:
    return running.processes["ros_bridge"]


def asked_for(ask: Callable[[], object], bridge: ServiceProcess, sentence: str) -> bool:
    """Whether the bridge logs this once it is asked; it may be asked before DDS has found the way to it, and not hear it."""
    ask()
    with suppress(AssertionError):
        eventually(lambda: sentence in bridge.output(), "it is heard", PATIENCE / 10)
    return sentence in bridge.output()


def test_a_reply_is_sent_again_until_it_goes_out() -> None:
    tried: list[tuple[str, ...]] = []

    def send(*reply: str) -> None:
        tried.append(reply)
        if len(tried) < 3:
            warnings.warn(
                "failed to send response (timeout): client will not receive response", RuntimeWarning, stacklevel=2
            )

    insistent(send)("service", "reply")
    assert tried == [("service", "reply")] * 3


@pytest.mark.slow
def test_an_undiscovered_client_is_given_up_and_logged(running: Stack, bridge: ServiceProcess, node: Node) -> None:
    lost = node.create_client(Trigger, "/unified_planner/get_robot_strategy", qos_profile=NOT_FOUND)
    assert RosClient(node).call(Trigger, "get_robot_strategy").success  # so DDS has told the bridge of the lost one too
    sentence = "a client of /unified_planner/get_robot_strategy has no reply"
    eventually(partial(asked_for, lambda: lost.call_async(Trigger.Request()), bridge, sentence), "the log tells of it")
    assert "default QoS of services" in bridge.output()
    assert "Traceback" not in bridge.output()
    assert running.ros.call(Trigger, "get_robot_strategy").success


@pytest.mark.slow
def test_a_goal_whose_acceptance_cannot_be_sent_moves_nothing(
    running: Stack, bridge: ServiceProcess, node: Node
) -> None:
    Robot(running.bus, KEYS).plan()
    lost = ActionClient(node, SendTrajectory, ACTION, goal_service_qos_profile=NOT_FOUND)
    ask = partial(node.executor.create_task, lost.send_goal_async, SendTrajectory.Goal())
    eventually(partial(asked_for, ask, bridge, "Failed to send goal response"), "the log tells of it")
    assert "goal" not in running.processes["executor"].output()
    assert Actions(running.ros.node).send().ended()[0] == SUCCEEDED
