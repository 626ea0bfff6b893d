"""The ROS bridge's process, in which the thread of the first goal is slow: it begins when another goal moves the robot."""

from __future__ import annotations

import sys
import time

from zarm_ros_bridge import service
from zarm_ros_bridge.goals import Run
from zarm_ros_bridge.turns import Turns

take = Turns.take


def slowly(self: Turns, run: Run, *, preempt: bool | None = None) -> None:
    while run.handle.arrival == 0 and self.running is None:
        time.sleep(0.01)
    take(self, run, preempt=preempt)


if __name__ == "__main__":
    Turns.take = slowly  # type: ignore[method-assign]
    sys.exit(service.main())
