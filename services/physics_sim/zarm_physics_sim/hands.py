"""The grippers of the arm: their commands, and what became of them."""

from __future__ import annotations

from collections.abc import Callable

from zarm_contract.messages import DriverGripperCommand, DriverGripperState
from zarm_physics_sim.arm import GripperDrive, PhysicalArm

_STEPS_PER_REPORT = 5
"""A gripper at rest is reported at every this many steps."""
_POSITION_TOLERANCE = 5e-4
"""A joint this close to its command is there (rad, m)."""
_REST_VELOCITY = 2e-3
"""A joint slower than this does not move (rad/s, m/s)."""
_STALLED = 0.1
"""Fingers that do not move for this long have stalled, s."""


class PhysicalHands:
    """The grippers of `arm`. One call at a time."""

    def __init__(self, arm: PhysicalArm) -> None:
        self._arm = arm
        self._still: dict[str, float] = {}
        self._steps = 0

    def play(self, command: DriverGripperCommand) -> None:
        """Move to this from the next step on."""
        if (drive := self._arm.grippers.get(command.gripper)) is not None:
            drive.command, drive.target = command, command.position
            drive.speed, drive.force = command.speed, command.force
            position = self._position(drive)
            if (drive.reference - position) * (drive.target - position) < 0.0:
                drive.reference = position  # what squeezed is released now, and not when its reference has come back
            self._still[command.gripper] = 0.0

    def step(self, dt: float, obstacle: float | None, report: Callable[[DriverGripperState], None]) -> None:
        """Report after `dt` s in which fingers do not close further than `obstacle` (m)."""
        self._steps += 1
        for name, drive in self._arm.grippers.items():
            position, velocity = self._position(drive), self._velocity(drive)
            if drive.command is not None:
                drive.target = _stopped(drive, obstacle)
            self._still[name] = self._still.get(name, 0.0) + dt if abs(velocity) < _REST_VELOCITY else 0.0
            if self._still[name] == 0.0 or self._steps % _STEPS_PER_REPORT == 0:
                report(self._state(name, drive, position))

    def _position(self, drive: GripperDrive) -> float:
        return float(self._arm.simulation.finger_position[self._driven(drive)])

    def _velocity(self, drive: GripperDrive) -> float:
        return float(self._arm.simulation.finger_velocity[self._driven(drive)])

    def _driven(self, drive: GripperDrive) -> int:
        return [finger.joint for finger in self._arm.simulation.fingers].index(drive.gripper.joint)

    def _state(self, name: str, drive: GripperDrive, position: float) -> DriverGripperState:
        command = drive.command
        if command is None:
            return DriverGripperState(gripper=name, position=position)
        there = abs(position - command.position) < _POSITION_TOLERANCE
        stalled = not there and self._still[name] >= _STALLED
        return DriverGripperState(
            gripper=name, position=position, sequence=command.sequence, reached=there, stalled=stalled
        )


def _stopped(drive: GripperDrive, obstacle: float | None) -> float:
    """Where the fingers go beside an imagined object of a width (m)."""
    wanted = drive.command.position if drive.command is not None else drive.target
    if obstacle is None or drive.gripper.width(wanted) >= obstacle:
        return wanted
    return drive.gripper.position(obstacle)
