"""The order in which action goals arrived, which the threads that execute them do not keep."""

from __future__ import annotations

import itertools
from typing import Any

from rclpy.action import ActionServer
from rclpy.action.server import ServerGoalHandle

from zarm_ros_bridge.rclpy_parts import goal_asked_for, goal_taken_up

_arrivals = itertools.count()


class OrderedActionServer(ActionServer):  # type: ignore[misc] # rclpy is not followed
    """An action server whose goal handles have an `arrival`, which increases with each goal that arrives in this
    process.

    rclpy receives the requests one by one; from then on each has its own thread.
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        self._coming: dict[int, int] = {}  # by the identity of the request, since two clients may use the same id
        super().__init__(*arguments, handle_accepted_callback=self._accepted, **options)

    def take_data(self) -> dict[str, Any]:
        """Called by rclpy, for one request at a time."""
        data: dict[str, Any] = super().take_data()
        if (goal := goal_asked_for(data)) is not None:
            self._coming[id(goal)] = next(_arrivals)
        return data

    async def execute(self, taken_data: dict[str, Any]) -> None:
        """Called by rclpy, from any thread."""
        try:
            await super().execute(taken_data)
        finally:
            if (goal := goal_asked_for(taken_data)) is not None:
                del self._coming[id(goal)]

    def take_up(self, goal: bytes) -> None:
        """Continue a goal that an earlier server of this name had accepted, unless it is known here. Its handle has no
        request.
        """
        if (handle := goal_taken_up(self, goal)) is not None:
            handle.arrival = next(_arrivals)
            handle.execute()

    def _accepted(self, handle: ServerGoalHandle) -> None:
        handle.arrival = self._coming[id(handle.request)]
        handle.execute()
