"""The controller of a gripper under ros2_control, driven through its action."""

from __future__ import annotations

import logging
import threading
from functools import partial
from typing import Any

from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from rclpy.task import Future

from zarm_contract.messages import DriverGripperCommand, DriverGripperState
from zarm_ros_bridge.answers import shortened
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.gripper_dialects import DIALECTS, Move
from zarm_ros_bridge.ros import Ros

log = logging.getLogger(__name__)

_DISCOVERY, _AGAIN = 1.0, 0.05
"""How long (s) a controller may stay undiscovered, and how often that is looked at."""


class GripperDriver:
    """Passes the commands to the gripper `name` on to `action`, and reports what becomes of the newest.

    `ros` has one thread, in which all of this happens, as in `ControllerAction`.
    """

    def __init__(self, ros: Ros, engine: Engine, name: str, action: str) -> None:
        gripper = engine.robot.descriptor.grippers[name]
        self._name, self._action, self._run = name, action, ros.run
        self._joint, self._dialect = gripper.joint, DIALECTS[gripper.action_type]
        self._client = ActionClient(ros.node, self._dialect.kind, action, callback_group=ros.group)
        self._states = engine.bus.publisher(engine.keys.driver_gripper_state)
        self._newest = 0
        engine.bus.subscribe(engine.keys.driver_gripper_command, self._receive)

    def _receive(self, _: str, command: DriverGripperCommand) -> None:
        if command.gripper == self._name:
            self._run(partial(self._send, command))

    def _send(self, command: DriverGripperCommand, waited: float = 0.0) -> None:
        if waited and command.sequence != self._newest:
            return
        self._newest = command.sequence
        if not self._client.server_is_ready():
            if waited < _DISCOVERY:
                threading.Timer(_AGAIN, self._run, (partial(self._send, command, waited + _AGAIN),)).start()
            else:
                self._give_up(
                    command.sequence, f"nobody serves {self._action}; start the controller, and see that it is active"
                )
            return
        goal = self._dialect.write(Move(command.position, command.speed, command.force), self._joint)
        sent = self._client.send_goal_async(goal, feedback_callback=partial(self._fed_back, command.sequence))
        sent.add_done_callback(partial(self._answered, command.sequence))

    def _fed_back(self, sequence: int, message: Any) -> None:
        self._report(sequence, message.feedback, ended=False)

    def _answered(self, sequence: int, future: Future) -> None:
        handle = future.result()
        if handle.accepted:
            handle.get_result_async().add_done_callback(partial(self._ended, sequence))
        else:
            self._give_up(
                sequence, f"{self._action} refused the command; see the controller's log, and whether it is active"
            )

    def _ended(self, sequence: int, future: Future) -> None:
        response = future.result()
        if response.status == GoalStatus.STATUS_SUCCEEDED or response.result.stalled:
            self._report(sequence, response.result, ended=True)
        elif response.status == GoalStatus.STATUS_CANCELED:
            self._give_up(sequence, f"another client has cancelled the command of {self._action}")
        else:
            self._give_up(sequence, f"{self._action} has given up; see the controller's log")

    def _report(self, sequence: int, message: Any, *, ended: bool) -> None:
        if sequence == self._newest:
            self._states.put(
                DriverGripperState(
                    gripper=self._name,
                    position=self._dialect.position(message),
                    sequence=sequence,
                    reached=ended and not message.stalled,
                    stalled=ended and message.stalled,
                )
            )

    def _give_up(self, sequence: int, reason: str) -> None:
        if sequence == self._newest:
            log.warning("the gripper gave up gripper=%s reason=%s", self._name, reason)
            self._states.put(DriverGripperState(gripper=self._name, sequence=sequence, problem=shortened(reason)))
