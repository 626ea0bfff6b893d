"""The grippers of the arm: their commands, and what became of them."""

from __future__ import annotations

from collections.abc import Callable

from zarm_contract.messages import DriverGripperCommand, DriverGripperState
from zarm_physics_sim.arm import Finger, PhysicalArm

_EVERY = 5
"""A gripper at rest is reported at every this many steps."""
_THERE = 5e-4
"""A joint this close to its command is there (rad, m)."""
_STILL = 2e-3
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
        if (finger := self._arm.fingers.get(command.gripper)) is not None:
            finger.command, finger.target = command, command.position
            finger.speed, finger.force = command.speed, command.force
            self._still[command.gripper] = 0.0

    def step(self, dt: float, obstacle: float | None, report: Callable[[DriverGripperState], None]) -> None:
        """Report after `dt` s in which fingers do not close further than `obstacle` (m)."""
        self._steps += 1
        simulation = self._arm.simulation
        states = zip(simulation.gripper_position, simulation.gripper_velocity, strict=True)
        for (name, finger), (position, velocity) in zip(self._arm.fingers.items(), states, strict=True):
            if finger.command is not None:
                finger.target = _stopped(finger, obstacle)
            self._still[name] = self._still.get(name, 0.0) + dt if abs(velocity) < _STILL else 0.0
            if self._still[name] == 0.0 or self._steps % _EVERY == 0:
                report(self._state(name, finger, float(position)))

    def _state(self, name: str, finger: Finger, position: float) -> DriverGripperState:
        command = finger.command
        if command is None:
            return DriverGripperState(gripper=name, position=position)
        there = abs(position - command.position) < _THERE
        stalled = not there and self._still[name] >= _STALLED
        return DriverGripperState(
            gripper=name, position=position, sequence=command.sequence, reached=there, stalled=stalled
        )


def _stopped(finger: Finger, obstacle: float | None) -> float:
    """Where the fingers go beside an imagined object of a width (m)."""
    wanted = finger.command.position if finger.command is not None else finger.target
    if obstacle is None or finger.gripper.width(wanted) >= obstacle:
        return wanted
    return finger.gripper.position(obstacle)
