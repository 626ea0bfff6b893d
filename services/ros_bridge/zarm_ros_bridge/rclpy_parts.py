"""What is used of rclpy beside its interface, and may be another with any version; nothing else of the bridge knows of it.

Tried with rclpy 7.1.5 and 7.1.6 (ROS 2 Jazzy). tests/ros/test_rclpy_parts.py says what a new version has changed.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.parameter import Parameter
from rclpy.parameter_service import ParameterService

RCLError = rclpy_implementation.RCLError
SENDERS = (
    (rclpy_implementation.Service, "service_send_response"),
    (rclpy_implementation.ActionServer, "send_goal_response"),
    (rclpy_implementation.ActionServer, "send_cancel_response"),
    (rclpy_implementation.ActionServer, "send_result_response"),
)
"""Where rclpy sends replies: class and name of the method. Where there is no way yet to the client it warns `UNSENT`."""
UNSENT = "failed to send response"


def goal_asked_for(taken: dict[str, Any]) -> Any | None:
    """The goal among what `ActionServer.take_data` has taken, if there is one; the goal's handle has the same as `request`."""
    return taken["goal"][1].goal if "goal" in taken else None


class CheckedParameterService(ParameterService):  # type: ignore[misc] # rclpy is not followed
    """Those of rclpy, which raise where a type of a parameter is none, and leave the client without an answer."""

    def _set_parameters_callback(self, request: Any, response: Any) -> Any:
        if (fault := _fault(request.parameters)) is None:
            return super()._set_parameters_callback(request, response)
        response.results = [fault for _ in request.parameters]
        return response

    def _set_parameters_atomically_callback(self, request: Any, response: Any) -> Any:
        if (fault := _fault(request.parameters)) is None:
            return super()._set_parameters_atomically_callback(request, response)
        response.result = fault
        return response


def _fault(parameters: Iterable[Any]) -> SetParametersResult | None:
    known = {kind.value for kind in Parameter.Type}
    for parameter in parameters:
        if (kind := parameter.value.type) not in known:
            return SetParametersResult(
                successful=False, reason=f"{parameter.name} is given with the type {kind}, and there is none such"
            )
    return None
