"""Private parts of rclpy that any version may change; only this module uses them.

Tested with rclpy 7.1.5 and 7.1.6 (ROS 2 Jazzy). tests/ros/test_rclpy_parts.py shows what a new version has changed.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable, Iterator
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.action import ActionServer
from rclpy.action.server import GoalInfo, ServerGoalHandle
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.parameter_service import ParameterService
from rclpy.subscription import Subscription
from rclpy.task import Future

RCLError = rclpy_implementation.RCLError
WaitSet = rclpy_implementation.WaitSet
SENDERS = (
    (rclpy_implementation.Service, "service_send_response"),
    (rclpy_implementation.ActionServer, "send_goal_response"),
    (rclpy_implementation.ActionServer, "send_cancel_response"),
    (rclpy_implementation.ActionServer, "send_result_response"),
)
"""Where rclpy sends replies: class and name of the method. If the client cannot be reached yet, it warns `UNSENT`."""
UNSENT = "failed to send response"

MESSAGES_PER_TURN = 16
"""Most messages taken from one topic before the others get their turn."""
CALM = 1.0
"""How long (s) a `Reception` must receive only deferrable messages before any are deferred."""


def goal_asked_for(taken: dict[str, Any]) -> Any | None:
    """The goal in the result of `ActionServer.take_data`, if any; the same object as `request` of the goal's handle."""
    return taken["goal"][1].goal if "goal" in taken else None


def goal_taken_up(server: ActionServer, goal: bytes) -> ServerGoalHandle | None:
    """The handle of a goal that an earlier server had accepted, without its request; None if this server already knows
    it.
    """
    info = GoalInfo()
    info.goal_id.uuid = list(goal)
    with server._lock:
        if server._handle.goal_exists(info):
            return None
        handle = ServerGoalHandle(server, info, None)
        server._goal_handles[goal] = handle
        server._result_futures[goal] = Future()
    server.add_future(server._result_futures[goal])
    return handle


class Reception:
    """Receives the subscriptions of a node that has nothing else, in one thread.

    It waits as `rclpy.wait_for_message` does, with one wait set. An rclpy executor builds three of them for each
    message, out of every entity of its nodes: at 100 Hz that took 7 % of a core, this takes 2 %.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._end = node.create_guard_condition(None)
        self._ended = False
        self._hurried = threading.Event()
        self._calm_at = 0.0

    def run(self) -> None:
        """Call the callback of each message, and of each subscription event, until `end`. Raises what a callback
        raises.

        If all callbacks return a number of seconds, and have for `CALM` s, nothing is received for that long, or until
        `hurry`; then whatever has arrived is.
        """
        subscriptions = list(self._node.subscriptions)
        events = [event for subscription in subscriptions for event in subscription.event_handlers]
        wait_set = WaitSet(len(subscriptions), 1, 0, 0, 0, len(events), self._node.context.handle)
        while not self._ended:
            wait_set.clear_entities()
            wait_set.add_guard_condition(self._end.handle)
            places = [wait_set.add_subscription(subscription.handle) for subscription in subscriptions]
            for event in events:
                event.add_to_wait_set(wait_set)
            wait_set.wait(-1)
            pauses = [
                subscription.callback(message) or 0.0
                for subscription, place in zip(subscriptions, places, strict=True)
                if wait_set.is_ready("subscription", place)
                for message in _taken(subscription)
            ]
            for event in events:
                if event.is_ready(wait_set) and (status := event.take_data()):
                    event.callback(status)
            self._pause(min(pauses, default=0.0))

    def _pause(self, seconds: float) -> None:
        now = time.monotonic()
        if not seconds or self._hurried.is_set():
            self._hurried.clear()
            self._calm_at = now + CALM
        elif now > self._calm_at:
            self._hurried.wait(seconds)

    def hurry(self) -> None:
        """End a pause, and allow none for `CALM` s; may be called from any thread."""
        self._hurried.set()

    def end(self) -> None:
        """Make `run` return; may be called from any thread."""
        self._ended = True
        self._hurried.set()
        self._end.trigger()


def _taken(subscription: Subscription) -> Iterator[Any]:
    """The messages waiting on a subscription, at most `MESSAGES_PER_TURN`."""
    for _ in range(MESSAGES_PER_TURN):
        if (taken := subscription.handle.take_message(subscription.msg_type, subscription.raw)) is None:
            return
        yield taken[0]


class CheckedParameterService(ParameterService):  # type: ignore[misc] # rclpy is not followed
    """rclpy's parameter services, which raise for an invalid parameter type and leave the client without an answer."""

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
