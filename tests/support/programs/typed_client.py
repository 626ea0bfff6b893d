"""A ROS client with only the message classes of the packages on its path: it executes requests from standard input.

Each line is JSON: `{"service": NAME, "type": "curobo_msgs/srv/Fk", "request": {...}}`, the same with `action` and
`goal`, or `parameter` alone; each answer is a line of JSON, with the field names of the message.
"""

from __future__ import annotations

import importlib
import json
import sys
from array import array
from typing import Any

import rclpy
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.task import Future

PATIENCE = 60.0


def kind_of(name: str) -> Any:
    package, folder, kind = name.split("/")
    return getattr(importlib.import_module(f"{package}.{folder}"), kind)


def filled(message: Any, fields: dict[str, Any]) -> Any:
    """The message with these fields, which may be nested."""
    types = message.get_fields_and_field_types()
    for name, value in fields.items():
        present, kind = getattr(message, name), types[name].removeprefix("sequence<").removesuffix(">")
        if isinstance(value, dict):
            value = filled(present, value)
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            package, item = kind.split("/")
            value = [filled(kind_of(f"{package}/msg/{item}")(), one) for one in value]
        setattr(message, name, value)
    return message


def plain(value: Any) -> Any:
    """A message in JSON form."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    return [plain(one) for one in value] if isinstance(value, list | array) else value


class TypedClient:
    def __init__(self) -> None:
        rclpy.init()
        self.node = Node("typed_client")
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)

    def result(self, future: Future) -> Any:
        self.executor.spin_until_future_complete(future, PATIENCE)
        if not future.done():
            raise SystemExit("no answer")
        return future.result()

    def service(self, name: str, kind: Any, request: dict[str, Any]) -> Any:
        client = self.node.create_client(kind, f"/unified_planner/{name}")
        if not client.wait_for_service(PATIENCE):
            raise SystemExit(f"there is no service {name}")
        answer = self.result(client.call_async(filled(kind.Request(), request)))
        self.node.destroy_client(client)
        return plain(answer)

    def action(self, name: str, kind: Any, goal: dict[str, Any]) -> Any:
        client = ActionClient(self.node, kind, f"/unified_planner/{name}")
        if not client.wait_for_server(PATIENCE):
            raise SystemExit(f"there is no action {name}")
        feedback: list[Any] = []
        sent = client.send_goal_async(
            filled(kind.Goal(), goal), lambda reported: feedback.append(plain(reported.feedback))
        )
        ended = self.result(self.result(sent).get_result_async())
        client.destroy()
        return {"status": ended.status, "result": plain(ended.result), "feedback": feedback}

    def parameter(self, name: str) -> Any:
        client = AsyncParameterClient(self.node, "/unified_planner")
        if not client.wait_for_services(PATIENCE):
            raise SystemExit("there are no parameters")
        return parameter_value_to_python(self.result(client.get_parameters([name])).values[0])


def main() -> None:
    client = TypedClient()
    for line in sys.stdin:
        asked = json.loads(line)
        if "parameter" in asked:
            answer = client.parameter(asked["parameter"])
        elif "service" in asked:
            answer = client.service(asked["service"], kind_of(asked["type"]), asked["request"])
        else:
            answer = client.action(asked["action"], kind_of(asked["type"]), asked["goal"])
        sys.stdout.write(json.dumps(answer) + "\n")
        sys.stdout.flush()
    client.executor.shutdown()
    rclpy.shutdown()


if __name__ == "__main__":
    main()
