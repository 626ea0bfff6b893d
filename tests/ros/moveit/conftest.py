"""A robot whose bridge serves MoveIt's interface, and clients of it."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node

from support.ros.node import spinning
from support.ros.stack import Stack, stack


@pytest.fixture(scope="package")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """Planner, executor, servo and a bridge with `--moveit`, of an M1013 without a driver.

    It is the only one on its ROS domain: the names of MoveIt are the same for every robot.
    """
    with stack(tmp_path_factory.mktemp("moveit"), ros_bridge=("--moveit",), servo=()) as processes:
        yield processes


@pytest.fixture
def client() -> Iterator[Node]:
    """A node for a client of MoveIt."""
    with spinning("moveit_client") as node:
        yield node


@pytest.fixture
def group() -> ReentrantCallbackGroup:
    """Its callbacks may run at the same time."""
    return ReentrantCallbackGroup()
