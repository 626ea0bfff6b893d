"""A replacement for the `ros2` command on machines without it: a separate process, rclpy, and the arguments as typed.

    python ros2_command.py service call /unified_planner/get_robot_strategy std_srvs/srv/Trigger

Prints the reply as YAML, and the end of an action goal in the words of `ros2 action send_goal`. Exit code 1 if it
fails.
"""

from __future__ import annotations

import argparse
import importlib
import sys
import time
from collections.abc import Callable, Mapping
from typing import Any

import rclpy
import yaml
from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import qos_profile_sensor_data

PATIENCE = 60.0


def plain(message: Any) -> Any:
    """A message as mappings, lists and values."""
    if hasattr(message, "get_fields_and_field_types"):
        return {name: plain(getattr(message, name)) for name in message.get_fields_and_field_types()}
    if isinstance(message, str | bytes | bool | int | float):
        return message
    return [plain(item) for item in message]


def fill(message: Any, values: Mapping[str, Any]) -> Any:
    """Set the fields of a message that the YAML names; numbers are converted to the field's type."""
    for name, value in values.items():
        field = getattr(message, name)
        if isinstance(value, dict):
            fill(field, value)
        else:
            setattr(message, name, type(field)(value) if isinstance(field, bool | int | float | str) else value)
    return message


def wait(node: Node, future: Any) -> Any:
    rclpy.spin_until_future_complete(node, future, timeout_sec=PATIENCE)
    if not future.done():
        raise TimeoutError("no answer")
    return future.result()


def there(waiting: Callable[..., bool]) -> None:
    if not waiting(timeout_sec=PATIENCE):
        raise TimeoutError("nobody serves that")


def kind_of(name: str) -> Any:
    package, interface, kind = name.split("/")
    return getattr(importlib.import_module(f"{package}.{interface}"), kind)


def say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def show(message: Any) -> None:
    say(yaml.safe_dump(plain(message), sort_keys=False))


def param(node: Node, verb: str, of: str, name: str, value: str = "") -> None:
    client = AsyncParameterClient(node, of)
    there(client.wait_for_services)
    if verb == "get":
        show([parameter_value_to_python(wait(node, client.get_parameters([name])).values[0])])
        return
    result = wait(node, client.set_parameters([Parameter(name, value=yaml.safe_load(value) or "")])).results[0]
    say("Set parameter successful" if result.successful else f"Setting parameter failed: {result.reason}")


def service(node: Node, _: str, name: str, kind: str, values: str = "{}") -> None:
    client = node.create_client(kind_of(kind), name)
    there(client.wait_for_service)
    show(wait(node, client.call_async(fill(kind_of(kind).Request(), yaml.safe_load(values)))))


def action(node: Node, _: str, name: str, kind: str, values: str, *options: str) -> None:
    client = ActionClient(node, kind_of(kind), name)
    there(client.wait_for_server)

    def tell(message: Any) -> None:
        say("Feedback:")
        show(message.feedback)

    reported = tell if "--feedback" in options else None
    goal = wait(
        node, client.send_goal_async(fill(kind_of(kind).Goal(), yaml.safe_load(values)), feedback_callback=reported)
    )
    if not goal.accepted:
        say("Goal was rejected.")
        return
    ended = wait(node, goal.get_result_async())
    say("Result:")
    show(ended.result)
    words = {getattr(GoalStatus, word): word.removeprefix("STATUS_") for word in dir(GoalStatus) if "STATUS_" in word}
    say(f"Goal finished with status: {words[ended.status]}")


def topic(node: Node, verb: str, name: str = "") -> None:
    deadline = time.monotonic() + PATIENCE
    known: dict[str, list[str]] = {}
    while not known.get(name) and time.monotonic() < deadline:
        rclpy.spin_once(node, timeout_sec=0.1)
        known = dict(node.get_topic_names_and_types())
        if verb == "list" and len(known) > 3:
            say("\n".join(known))
            return
    if verb == "info":
        while not (node.count_publishers(name) and node.count_subscribers(name)) and time.monotonic() < deadline:
            rclpy.spin_once(node, timeout_sec=0.1)  # each is discovered separately; `ros2` asks a daemon that knows all
        say(f"Type: {known[name][0]}\nPublisher count: {node.count_publishers(name)}")
        say(f"Subscription count: {node.count_subscribers(name)}")
        return
    heard: list[float] = []
    node.create_subscription(
        kind_of(known[name][0]), name, lambda _: heard.append(time.monotonic()), qos_profile_sensor_data
    )
    while len(heard) < 50 and time.monotonic() < deadline:
        rclpy.spin_once(node, timeout_sec=0.1)
    say(f"average rate: {(len(heard) - 1) / (heard[-1] - heard[0]):.3f}")


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("what", choices=("param", "service", "action", "topic"))
    parser.add_argument("words", nargs=argparse.REMAINDER)
    given = parser.parse_args()
    rclpy.init(args=[])
    node = rclpy.create_node("ros2_command")
    try:
        {"param": param, "service": service, "action": action, "topic": topic}[given.what](node, *given.words)
    except (TimeoutError, IndexError, KeyError) as error:
        sys.stderr.write(f"failed: {error}\n")
        return 1
    finally:
        node.destroy_node()
        rclpy.shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
