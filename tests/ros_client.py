"""A ROS 2 node for tests, as any client of the bridge has one: plain rclpy."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import Any, Self

import rclpy
from harness import PATIENCE, eventually
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile


class RosClient:
    """A node in a context of its own, spun by a thread; use it in `with`."""

    def __init__(self, name: str = "client") -> None:
        self.context = Context()
        rclpy.init(args=[], context=self.context)
        self.node = Node(name, context=self.context)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._executor.spin)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._executor.shutdown()
        self._thread.join()
        self.node.destroy_node()
        self.context.shutdown()

    def heard(self, kind: type[Any], topic: str, qos: QoSProfile | int = 10) -> list[Any]:
        """A list to which every message on `topic` is added from now on; the publisher is known when this returns."""
        messages: list[Any] = []
        subscription = self.node.create_subscription(kind, topic, messages.append, qos)
        eventually(subscription.get_publisher_count, f"somebody publishes {topic}")
        return messages

    def wait(self, future: Any) -> Any:
        """The result of a future of rclpy."""
        done = threading.Event()
        future.add_done_callback(lambda _: done.set())
        assert done.wait(PATIENCE), "no answer"
        return future.result()

    def call(self, kind: type[Any], service: str, request: Any = None) -> Any:
        """The answer of a service."""
        client = self.node.create_client(kind, service)
        try:
            assert client.wait_for_service(PATIENCE), f"nobody serves {service}"
            return self.wait(client.call_async(kind.Request() if request is None else request))
        finally:
            self.node.destroy_client(client)


def one(messages: Sequence[Any], what: str) -> Any:
    """The first message that comes."""
    return eventually(lambda: messages and messages[0], what)
