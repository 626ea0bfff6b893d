"""What the bridge uses of rclpy beside its interface is there, in the shape that `rclpy_parts` has tried."""

from __future__ import annotations

import inspect

import pytest
from rclpy.action import ActionServer
from rclpy.parameter_service import ParameterService

from zarm_ros_bridge.rclpy_parts import SENDERS, CheckedParameterService, RCLError

CHANGED = "this version of rclpy is another than zarm_ros_bridge/rclpy_parts.py has tried: "


@pytest.mark.parametrize(("kind", "name"), SENDERS, ids=[name for _, name in SENDERS])
def test_replies_are_sent_where_the_bridge_sends_them_again(kind: type, name: str) -> None:
    assert callable(getattr(kind, name, None)), f"{CHANGED}{kind.__name__} sends no replies by {name}"
    assert issubclass(RCLError, Exception)


@pytest.mark.parametrize("name", [name for name in vars(CheckedParameterService) if name.endswith("_callback")])
def test_the_requests_of_parameters_come_where_the_bridge_checks_them(name: str) -> None:
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
