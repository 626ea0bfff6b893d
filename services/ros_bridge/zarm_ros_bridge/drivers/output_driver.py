"""A digital output that a ROS service switches."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from functools import partial

from rclpy.task import Future
from std_srvs.srv import SetBool

from zarm_contract.messages import DriverOutputCommand, DriverOutputState, OutputState
from zarm_ros_bridge.answers import shortened
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.ros import Ros

log = logging.getLogger(__name__)

_DISCOVERY, _AGAIN = 1.0, 0.05
"""How long (s) a service may stay undiscovered, and how often that is looked at."""
_RETRY = 1.0
"""A service that has not answered for so long (s) is called again: who serves it may have been replaced, and the request is lost with the former one."""


class OutputDriver:
    """Passes the commands to the output `name` on to `service`, and reports what becomes of the newest.

    `ros` has one thread, in which all of this happens, as in `ControllerAction`. For `timeout` s a service without answer is called again and again, switching on
    twice being the same as once, but no longer than the executor waits: what it has given up must not be switched later.
    """

    def __init__(self, ros: Ros, engine: Engine, name: str, service: str, timeout: float) -> None:
        self._name, self._service, self._timeout, self._run = name, service, timeout, ros.run
        self._client = ros.node.create_client(SetBool, service, callback_group=ros.group)
        self._states = engine.bus.publisher(engine.keys.driver_output_state)
        self._newest = 0
        self._calls: list[Future] = []
        self._awaited = False
        engine.bus.subscribe(engine.keys.driver_output_command, self._receive)
        engine.bus.watch(engine.keys.output_state(name), self._on_state)

    def _receive(self, _: str, command: DriverOutputCommand) -> None:
        if command.output == self._name:
            self._awaited = True
            self._run(partial(self._send, command, time.monotonic() + self._timeout))

    def _on_state(self, _: str, state: OutputState) -> None:
        if state.problem is not None:
            self._awaited = False

    def _send(self, command: DriverOutputCommand, until: float, waited: float = 0.0) -> None:
        if waited and command.sequence != self._newest:
            return
        if command.sequence != self._newest:
            self._forget_calls()
        self._newest = command.sequence
        if self._client.service_is_ready():
            called = self._client.call_async(SetBool.Request(data=command.on))
            self._calls.append(called)
            called.add_done_callback(partial(self._answered, command.sequence))
            self._later(_RETRY, partial(self._repeat, command, until))
        elif waited < _DISCOVERY:
            self._later(_AGAIN, partial(self._send, command, until, waited + _AGAIN))
        else:
            self._report(command.sequence, f"nobody serves {self._service}; start the robot's driver")

    def _later(self, seconds: float, work: Callable[[], None]) -> None:
        timer = threading.Timer(seconds, self._run, (work,))
        timer.daemon = True
        timer.start()

    def _repeat(self, command: DriverOutputCommand, until: float) -> None:
        if self._calls and self._awaited and command.sequence == self._newest and time.monotonic() < until:
            log.info(
                "the service is called again, as it has not answered output=%s service=%s", self._name, self._service
            )
            self._send(command, until)

    def _forget_calls(self) -> None:
        for called in self._calls:
            self._client.remove_pending_request(called)
        self._calls.clear()

    def _answered(self, sequence: int, future: Future) -> None:
        if sequence != self._newest:
            return
        response = future.result()
        self._forget_calls()
        if response.success:
            self._report(sequence, None)
        else:
            self._report(sequence, f"{self._service} refused: {response.message or 'it gives no reason'}")

    def _report(self, sequence: int, problem: str | None) -> None:
        if problem is not None:
            log.warning("the output was not switched output=%s reason=%s", self._name, problem)
            problem = shortened(problem)
        self._states.put(DriverOutputState(output=self._name, sequence=sequence, problem=problem))
