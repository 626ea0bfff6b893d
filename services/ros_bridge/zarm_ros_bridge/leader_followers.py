"""The rclpy executor for callbacks that may wait, by the pattern Leader/Followers."""

from __future__ import annotations

import threading

from rclpy.context import Context
from rclpy.executors import Executor, ExternalShutdownException, ShutdownException


class LeaderFollowersExecutor(Executor):  # type: ignore[misc] # rclpy is not followed
    """`spin` it in as many threads as callbacks may run at once.

    One thread, the leader, waits for work; when there is some it does that itself, and one of the followers leads on. rclpy's
    MultiThreadedExecutor looks at every entity again before the thread of its pool, to which it gave a request, may begin with
    it, and without end while every thread of the pool has work.
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
