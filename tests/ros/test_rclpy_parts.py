"""What the bridge uses of rclpy beside its interface is there, in the shape that `rclpy_parts` has tried."""

from __future__ import annotations

import inspect
import threading

import pytest
import rclpy
from rclpy.action import ActionServer
from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter_service import ParameterService
from std_msgs.msg import String

from support.harness import PATIENCE, eventually
from support.ros.node import running_node
from zarm_ros_bridge.rclpy_parts import SENDERS, CheckedParameterService, RCLError, Reception

CHANGED = "this version of rclpy is another than zarm_ros_bridge/rclpy_parts.py has tried: "


@pytest.mark.parametrize(("kind", "name"), SENDERS, ids=[name for _, name in SENDERS])
def test_replies_are_sent_where_the_bridge_sends_them_again(kind: type, name: str) -> None:
    assert callable(getattr(kind, name, None)), f"{CHANGED}{kind.__name__} sends no replies by {name}"
    assert issubclass(RCLError, Exception)


@pytest.mark.parametrize("name", [name for name in vars(CheckedParameterService) if name.endswith("_callback")])
def test_parameter_requests_are_checked_by_the_bridge(name: str) -> None:
    callback = getattr(ParameterService, name, None)
    assert callback is not None, f"{CHANGED}ParameterService has no {name}"
    assert list(inspect.signature(callback).parameters) == ["self", "request", "response"], CHANGED + name


@pytest.mark.parametrize(
    ("kind", "name", "parameters"),
    [
        (ActionServer, "take_data", ["self"]),
        (ActionServer, "execute", ["self", "taken_data"]),
    ],
)
def test_what_the_bridge_overrides_and_calls_has_its_parameters(kind: type, name: str, parameters: list[str]) -> None:
    method = getattr(kind, name, None)
    assert method is not None, f"{CHANGED}{kind.__name__} has no {name}"
    assert list(inspect.signature(method).parameters) == parameters, f"{CHANGED}{kind.__name__}.{name}"


def test_topics_are_served_after_a_failing_callback() -> None:
    context = Context()
    rclpy.init(args=[], context=context)
    listener = Node("listener", context=context, start_parameter_services=False)
    heard: list[str] = []
    enough = threading.Event()

    def receive(message: String) -> None:
        heard.append(message.data)
        if len(heard) == 1:
            raise ValueError("the first")
        if {"/a", "/b"} <= set(heard):
            enough.set()

    for topic in ("/a", "/b"):
        listener.create_subscription(String, topic, receive, 10)
    reception = Reception(listener)

    def run() -> None:
        with pytest.raises(ValueError, match="the first"):
            reception.run()
        reception.run()

    thread = threading.Thread(target=run)
    thread.start()
    with running_node("talker") as talker:
        publishers = [talker.create_publisher(String, topic, 10) for topic in ("/a", "/b")]

        def tell() -> bool:
            for publisher in publishers:
                publisher.publish(String(data=publisher.topic_name))
            return enough.is_set()

        eventually(tell, "both topics are heard")
    reception.end()
    thread.join(PATIENCE)
    assert not thread.is_alive(), f"{CHANGED}what waits for messages does not end"
    listener.destroy_node()
    context.shutdown()
