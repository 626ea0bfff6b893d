"""The rclpy executor for callbacks that may wait, using the Leader/Followers pattern."""

from __future__ import annotations

import threading

from rclpy.context import Context
from rclpy.executors import Executor, ExternalShutdownException, ShutdownException


class LeaderFollowersExecutor(Executor):  # type: ignore[misc] # rclpy is not followed
    """`spin` it in as many threads as callbacks may run at once.

    One thread, the leader, waits for work; when there is some it does that itself, and a follower becomes the leader.
    rclpy's MultiThreadedExecutor checks every entity again before the pool thread that was given a request can begin,
    and busy-waits while all threads of the pool are working.
    """

    def __init__(self, context: Context) -> None:
        super().__init__(context=context)
        self._lead = threading.Lock()

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Do one piece of work; raises what its callback raises."""
        try:
            with self._lead:
                task, _, _ = self.wait_for_ready_callbacks(timeout_sec)
        except (ShutdownException, ExternalShutdownException):
            return
        task()
        task.result()
