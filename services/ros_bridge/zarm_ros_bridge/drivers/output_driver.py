"""A digital output that a ROS service switches."""

from __future__ import annotations

import logging
import threading
from functools import partial

from rclpy.task import Future
from std_srvs.srv import SetBool

from zarm_contract.messages import DriverOutputCommand, DriverOutputState
from zarm_ros_bridge.answers import shortened
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.ros import Ros

log = logging.getLogger(__name__)

_DISCOVERY, _AGAIN = 1.0, 0.05
"""How long (s) a service may stay undiscovered, and how often that is looked at."""


class OutputDriver:
    """Passes the commands to the output `name` on to `service`, and reports what becomes of the newest.

    `ros` has one thread, in which all of this happens, as in `ControllerAction`.
    """

    def __init__(self, ros: Ros, engine: Engine, name: str, service: str) -> None:
        self._name, self._service, self._run = name, service, ros.run
        self._client = ros.node.create_client(SetBool, service, callback_group=ros.group)
        self._states = engine.bus.publisher(engine.keys.driver_output_state)
        self._newest = 0
        engine.bus.subscribe(engine.keys.driver_output_command, self._receive)

    def _receive(self, _: str, command: DriverOutputCommand) -> None:
        if command.output == self._name:
            self._run(partial(self._send, command))

    def _send(self, command: DriverOutputCommand, waited: float = 0.0) -> None:
        if waited and command.sequence != self._newest:
            return
        self._newest = command.sequence
        if self._client.service_is_ready():
            called = self._client.call_async(SetBool.Request(data=command.on))
            called.add_done_callback(partial(self._answered, command.sequence))
        elif waited < _DISCOVERY:
            threading.Timer(_AGAIN, self._run, (partial(self._send, command, waited + _AGAIN),)).start()
        else:
            self._report(command.sequence, f"nobody serves {self._service}; start the robot's driver")

    def _answered(self, sequence: int, future: Future) -> None:
        response = future.result()
        if response.success:
            self._report(sequence, None)
        else:
            self._report(sequence, f"{self._service} refused: {response.message or 'it gives no reason'}")

    def _report(self, sequence: int, problem: str | None) -> None:
        if problem is not None:
            log.warning("the output was not switched output=%s reason=%s", self._name, problem)
            problem = shortened(problem)
        self._states.put(DriverOutputState(output=self._name, sequence=sequence, problem=problem))
