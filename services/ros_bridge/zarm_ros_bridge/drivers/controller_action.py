"""The trajectory controller of a robot under ros2_control, driven through its FollowJointTrajectory action."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from functools import partial
from typing import Any

from action_msgs.msg import GoalStatus
from control_msgs.action import FollowJointTrajectory
from rclpy.action import ActionClient
from rclpy.task import Future

from zarm_ros_bridge.ros import Ros

log = logging.getLogger(__name__)

_DISCOVERY, _AGAIN = 0.8, 0.05
"""How long (s) a controller may stay undiscovered, which is less than a robot may stand still; and how often that is looked at."""
_POLL_PERIOD = 0.5  # s
_Result = FollowJointTrajectory.Result
_NAMES = {
    _Result.INVALID_GOAL: "INVALID_GOAL",
    _Result.INVALID_JOINTS: "INVALID_JOINTS",
    _Result.OLD_HEADER_TIMESTAMP: "OLD_HEADER_TIMESTAMP",
    _Result.PATH_TOLERANCE_VIOLATED: "PATH_TOLERANCE_VIOLATED",
    _Result.GOAL_TOLERANCE_VIOLATED: "GOAL_TOLERANCE_VIOLATED",
}


class ControllerAction:
    """Sends trajectories as goals; a new one takes the place of the one that runs, as the controller does it.

    `give_up(sequence, reason)` is called when the controller refuses or ends the newest one before it is played. `ros` has one
    thread, in which all of this happens: rclpy's client of actions loses answers that come while it sends.
    """

    def __init__(self, ros: Ros, name: str, give_up: Callable[[int, str], None]) -> None:
        self._name = name
        self._give_up = give_up
        self._client = ActionClient(ros.node, FollowJointTrajectory, name, callback_group=ros.group)
        self._run = ros.run
        self._served = False
        ros.node.create_timer(_POLL_PERIOD, self._look, callback_group=ros.group)
        self._newest = self._waited_for = self._waits = 0
        self._handle: Any | None = None

    def _look(self) -> None:
        """Log when the controller comes and goes."""
        if (served := self.is_served()) != self._served:
            self._served = served
            log.info("a controller has %s action=%s", "come" if served else "gone", self._name)

    def is_served(self) -> bool:
        """Whether the controller's action is there."""
        return bool(self._client.server_is_ready())

    def play(self, sequence: int, trajectory: Any) -> None:
        """Play this trajectory from now on, the command of this number."""
        self._run(partial(self._send, sequence, trajectory))

    def stop(self, sequence: int) -> None:
        """Play nothing any more: the controller brings the robot to rest and holds it."""
        self._run(partial(self._cancel, sequence))

    def _send(self, sequence: int, trajectory: Any) -> None:
        self._newest = sequence
        if not self._client.server_is_ready():
            self._wait(sequence, trajectory)
            return
        sent = self._client.send_goal_async(FollowJointTrajectory.Goal(trajectory=trajectory))
        sent.add_done_callback(partial(self._answered, sequence))

    def _wait(self, sequence: int, trajectory: Any) -> None:
        """Send it soon, to a robot that rests and whose controller is not discovered yet; or give up."""
        if self._handle is not None or self._waited_for != sequence:
            self._waited_for, self._waits = sequence, 0
        self._waits += 1
        if self._handle is not None or self._waits * _AGAIN > _DISCOVERY:
            self._give_up(sequence, f"nobody serves {self._name}; start the controller, and see that it is active")
            return

        def again() -> None:
            if sequence == self._newest:
                self._send(sequence, trajectory)

        threading.Timer(_AGAIN, self._run, (again,)).start()

    def _answered(self, sequence: int, future: Future) -> None:
        handle = future.result()
        if not handle.accepted:
            if sequence == self._newest:
                self._give_up(
                    sequence, f"{self._name} refused the trajectory; see the controller's log, and whether it is active"
                )
            return
        if sequence != self._newest:  # a stop or another trajectory came meanwhile
            handle.cancel_goal_async()
            return
        self._handle = handle
        handle.get_result_async().add_done_callback(partial(self._ended, sequence, handle))

    def _ended(self, sequence: int, handle: Any, future: Future) -> None:
        if self._handle is handle:
            self._handle = None
        if sequence != self._newest:
            return
        response = future.result()
        result = response.result
        if response.status == GoalStatus.STATUS_SUCCEEDED:
            log.info("the controller has played the command sequence=%d", sequence)
        elif response.status == GoalStatus.STATUS_CANCELED:
            self._give_up(sequence, f"another client has cancelled the trajectory of {self._name}")
        else:
            code = _NAMES.get(result.error_code, str(result.error_code))
            said = f": {result.error_string}" if result.error_string else ""
            self._give_up(sequence, f"{self._name} ended with {code}{said}")

    def _cancel(self, sequence: int) -> None:
        self._newest = sequence
        if self._handle is not None:
            self._handle.cancel_goal_async()
            self._handle = None
