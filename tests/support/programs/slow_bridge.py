"""The ROS bridge's process, in which the thread of the first goal is slow: it begins when another goal moves the robot."""

from __future__ import annotations

import sys
import time

from zarm_ros_bridge import service
from zarm_ros_bridge.execution import ExecutionActions
from zarm_ros_bridge.goals import Run

take_turn = ExecutionActions._take_turn


def slowly(self: ExecutionActions, run: Run) -> None:
    while run.handle.arrival == 0 and self._running is None:
        time.sleep(0.01)
    take_turn(self, run)


if __name__ == "__main__":
    ExecutionActions._take_turn = slowly  # type: ignore[method-assign]
    sys.exit(service.main())
