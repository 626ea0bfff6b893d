"""What moves a gripper: its driver on the bus, or an emulation."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod

from zarm_contract.gripper import Gripper
from zarm_contract.keys import Keys
from zarm_contract.messages import DriverGripperCommand, DriverGripperState, JointState
from zarm_runtime import clock
from zarm_runtime.bus import Bus


class GripperLink(ABC):
    """One gripper. One call at a time."""

    @abstractmethod
    def command(self, position: float, speed: float, force: float) -> None:
        """Move the joint to `position` (rad, m) at `speed` (rad/s, m/s) with at most `force` (N), and hold."""

    @abstractmethod
    def tick(self, dt: float) -> None:
        """`dt` s have passed."""

    @abstractmethod
    def measured(self) -> tuple[float, float] | None:
        """The position of the joint (rad, m), and when it was measured (s, monotonic); None before the first."""

    @abstractmethod
    def report(self) -> DriverGripperState | None:
        """What the driver has said of the last command."""


class EmulatedGripper(GripperLink):
    """Fingers that nothing holds up."""

    def __init__(self, position: float) -> None:
        self.position = self._target = position
        self._speed = 0.0

    def command(self, position: float, speed: float, force: float) -> None:
        """From the next tick on, move."""
        self._target, self._speed = position, speed

    def tick(self, dt: float) -> None:
        """Move as far as the speed allows."""
        step = self._speed * dt
        self.position += min(max(self._target - self.position, -step), step)

    def measured(self) -> tuple[float, float] | None:
        """Where it is."""
        return self.position, clock.monotonic()

    def report(self) -> DriverGripperState | None:
        """The position says it all."""
        return None


class DrivenGripper(GripperLink):
    """The gripper `name` of a driver on the bus, which reports its joint on `driver/gripper/state`, or among the joints of the robot."""

    def __init__(self, bus: Bus, keys: Keys, name: str, gripper: Gripper) -> None:
        self._name, self._joint = name, gripper.joint
        self._commands = bus.publisher(keys.driver_gripper_command)
        self._sequence = 0
        self._lock = threading.Lock()
        self._measured: tuple[float, float] | None = None
        self._report: DriverGripperState | None = None
        bus.subscribe(keys.driver_gripper_state, self._receive)
        bus.subscribe(keys.driver_joint_states, self._receive_joints)

    def command(self, position: float, speed: float, force: float) -> None:
        """Send it to the driver."""
        with self._lock:
            self._sequence += 1
            self._report = None
        self._commands.put(
            DriverGripperCommand(
                gripper=self._name, sequence=self._sequence, position=position, speed=speed, force=force
            )
        )

    def tick(self, dt: float) -> None:
        """The driver has its own clock."""

    def measured(self) -> tuple[float, float] | None:
        """What the driver has reported last."""
        return self._measured

    def report(self) -> DriverGripperState | None:
        """What the driver has said of the last command."""
        return self._report

    def _receive(self, _key: str, state: DriverGripperState) -> None:
        if state.gripper != self._name:
            return
        with self._lock:
            if state.position is not None:
                self._measured = state.position, clock.monotonic()
            if state.sequence == self._sequence and (state.reached or state.stalled or state.problem):
                self._report = state

    def _receive_joints(self, _key: str, state: JointState) -> None:
        if self._joint in state.joint_names:
            self._measured = state.position[state.joint_names.index(self._joint)], clock.monotonic()
