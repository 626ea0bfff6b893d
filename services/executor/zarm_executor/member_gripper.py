"""The gripper of a robot that has an executor of its own, moved through that."""

from __future__ import annotations

import logging
import threading
import time
from concurrent.futures import ThreadPoolExecutor

from zarm_contract.errors import ZarmError
from zarm_contract.gripper import Gripper
from zarm_contract.keys import Keys
from zarm_contract.messages import DriverGripperState, GripperRequest, GripperState
from zarm_executor.gripper_links import GripperLink
from zarm_runtime import clock
from zarm_runtime.bus import Bus

log = logging.getLogger(__name__)

_ANSWER = 2.0
"""Longest wait (s) for the answer of the other executor."""


class MemberGripper(GripperLink):
    """The gripper `name` of the robot `robot` on the bus; `gripper` describes it."""

    def __init__(self, bus: Bus, robot: str, name: str, gripper: Gripper) -> None:
        self._bus, self._key, self._name, self._gripper = bus, Keys(robot).gripper, name, gripper
        self._requests = ThreadPoolExecutor(1, thread_name_prefix=f"gripper {name} of {robot}")
        self._lock = threading.Lock()
        self._asked: str | None = None
        self._count = 0
        self._measured: tuple[float, float] | None = None
        self._report: DriverGripperState | None = None
        bus.watch(Keys(robot).gripper_state(name), self._receive)

    def command(self, position: float, speed: float, force: float) -> None:
        """Ask the other executor for it."""
        with self._lock:
            self._count += 1
            self._asked, self._report = f"lead-grip-{self._count}-{time.monotonic_ns()}", None
            request = GripperRequest(
                gripper=self._name,
                position=position,
                speed=speed / self._gripper.joint_speed,
                force=force,
                preempt=True,
                goal_id=self._asked,
            )
        self._requests.submit(self._ask, request)

    def tick(self, dt: float) -> None:
        """The other executor has its own clock."""

    def measured(self) -> tuple[float, float] | None:
        """What the other executor has reported last."""
        return self._measured

    def report(self) -> DriverGripperState | None:
        """What became of the last command."""
        return self._report

    def _ask(self, request: GripperRequest) -> None:
        try:
            self._bus.call(self._key, request, timeout=_ANSWER)
        except ZarmError as error:
            with self._lock:
                if request.goal_id == self._asked:
                    self._report = DriverGripperState(gripper=self._name, problem=error.problem.message)

    def _receive(self, _key: str, state: GripperState) -> None:
        with self._lock:
            if state.position is not None:
                self._measured = state.position, clock.monotonic()
            if state.goal_id == self._asked and state.done:
                self._report = DriverGripperState(
                    gripper=self._name,
                    reached=state.status == "reached",
                    stalled=state.status == "stalled",
                    problem=None if state.problem is None else state.problem.message,
                )
