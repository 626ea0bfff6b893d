"""A ROS client that knows nothing of zarm: plain rclpy."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from rclpy.client import Client
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import QoSProfile

from support.harness import PATIENCE, eventually
from support.ros.node import answer


@dataclass
class RosClient:
    """A client of /unified_planner on a running node."""

    node: Node
    _clients: dict[str, Client] = field(default_factory=dict)

    def call(self, kind: Any, name: str, /, **request: Any) -> Any:
        """The response of a service, of /unified_planner unless its name begins with `/`."""
        client = self._clients.get(name)
        if client is None:
            client = self._clients[name] = self.node.create_client(
                kind, name if name.startswith("/") else f"/unified_planner/{name}"
            )
        assert client.wait_for_service(PATIENCE), f"there is no service {name}"
        return answer(client.call_async(kind.Request(**request)), f"{name} answers")

    def configure(self, **parameters: bool | float) -> None:
        """Set parameters, which must be accepted."""
        client = AsyncParameterClient(self.node, "/unified_planner")
        assert client.wait_for_services(PATIENCE)
        changes = [Parameter(name, value=value) for name, value in parameters.items()]
        for result in answer(client.set_parameters(changes), "the parameters are set").results:
            assert result.successful, result.reason

    def heard(self, kind: type[Any], topic: str, qos: QoSProfile | int = 10) -> list[Any]:
        """A list to which every message on `topic` is added from now on; the publisher is known when this returns.

        The publisher may not know of the subscription yet, as DDS discovers each direction separately: see `reported`.
        """
        messages: list[Any] = []
        subscription = self.node.create_subscription(kind, topic, messages.append, qos)
        eventually(subscription.get_publisher_count, f"somebody publishes {topic}")
        return messages


def one(messages: Sequence[Any], what: str) -> Any:
    """The first message that comes."""
    return eventually(lambda: messages and messages[0], what)


def reported(messages: Sequence[Any], tell: Callable[[], object], what: str) -> Any:
    """The first message that arrives after `tell()` makes someone publish; `tell()` is repeated each second until then.

    Messages published before the publisher knows of the subscriber are lost.
    """

    def again() -> Any:
        tell()
        deadline = time.monotonic() + 1.0
        while not messages and time.monotonic() < deadline:
            time.sleep(0.01)
        return messages and messages[0]

    return eventually(again, what)


def robot_type(node: Node, value: str | None = None) -> str:
    """The parameter robot_type, first set to `value` if given."""
    client = AsyncParameterClient(node, "/unified_planner")
    assert client.wait_for_services(PATIENCE)
    if value is not None:
        result = answer(client.set_parameters([Parameter("robot_type", value=value)]), "it is set").results[0]
        assert result.successful, result.reason
    return str(parameter_value_to_python(answer(client.get_parameters(["robot_type"]), "it is told").values[0]))
