"""A robot whose bridge serves MoveIt's interface, and clients of it."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
import rclpy
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.context import Context
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node

from support.ros.stack import Stack, stack


@pytest.fixture(scope="package")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """Planner, executor, servo and a bridge with `--moveit`, of an M1013 without a driver.

    It is the only one on its ROS domain: the names of MoveIt are the same for every robot.
    """
    with stack(tmp_path_factory.mktemp("moveit"), ros_bridge=("--moveit",), servo=()) as processes:
        yield processes


@contextmanager
def spinning(name: str) -> Iterator[Node]:
    """A node whose callbacks run on several threads, as pymoveit2 wants it."""
    context = Context()
    rclpy.init(args=[], context=context)
    node = Node(name, context=context)
    executor = MultiThreadedExecutor(2, context=context)
    executor.add_node(node)
    thread = threading.Thread(target=executor.spin)
    thread.start()
    try:
        yield node
    finally:
        executor.shutdown()
        thread.join()
        node.destroy_node()
        context.shutdown()


@pytest.fixture
def client() -> Iterator[Node]:
    """A node for a client of MoveIt."""
    with spinning("moveit_client") as node:
        yield node


@pytest.fixture
def group() -> ReentrantCallbackGroup:
    """Its callbacks may run at the same time."""
    return ReentrantCallbackGroup()
