"""The simulated grippers: fingers that move at the commanded speed, until an object stops them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

from zarm_contract.gripper import Gripper
from zarm_contract.messages import DriverGripperCommand, DriverGripperState

_POSITION_TOLERANCE = 1e-6
_STEPS_PER_REPORT = 5
"""A gripper at rest is reported at every this many steps, a moving one at each."""


class Fingers:
    """The grippers of a robot, open at first. One call at a time."""

    def __init__(self, grippers: Mapping[str, Gripper]) -> None:
        self._grippers = grippers
        self._positions = {name: gripper.positions[-1] for name, gripper in grippers.items()}
        self._commands: dict[str, DriverGripperCommand] = {}
        self._steps = 0

    def play(self, command: DriverGripperCommand) -> None:
        """Move to this from the next step on."""
        if command.gripper in self._grippers:
            self._commands[command.gripper] = command

    def step(self, dt: float, obstacle: float | None, report: Callable[[DriverGripperState], None]) -> None:
        """Move for `dt` s, and report; fingers do not close further than `obstacle` (m)."""
        self._steps += 1
        for state, moves in self._stepped(dt, obstacle):
            if moves or self._steps % _STEPS_PER_REPORT == 0:
                report(state)

    def _stepped(self, dt: float, obstacle: float | None) -> Iterator[tuple[DriverGripperState, bool]]:
        for name, gripper in self._grippers.items():
            before, command = self._positions[name], self._commands.get(name)
            if command is None:
                yield DriverGripperState(gripper=name, position=before), False
                continue
            most = command.speed * dt
            after = before + min(max(command.position - before, -most), most)
            stopped = obstacle is not None and gripper.width(after) < min(
                obstacle, gripper.width(before) + _POSITION_TOLERANCE
            )
            if stopped and obstacle is not None:
                after = gripper.position(min(obstacle, gripper.width(before)))
            self._positions[name] = after
            there = abs(after - command.position) < _POSITION_TOLERANCE
            yield (
                DriverGripperState(
                    gripper=name,
                    position=after,
                    sequence=command.sequence,
                    reached=there,
                    stalled=stopped and not there,
                ),
                after != before,
            )
