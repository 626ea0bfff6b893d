"""A stop of a goal at which an output is switched before the robot goes on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from zarm_contract.errors import Problem
from zarm_contract.messages import Hold
from zarm_executor.outputs import Output


@dataclass(frozen=True)
class OutputStop:
    """The robot waits before the path time `until` (s), within the rest that is planned there, until `output` is switched `on` or off."""

    until: float
    output: Output
    on: bool
    hold: ClassVar = Hold(reason="output")

    def begin(self, _: str) -> None:
        """Switch the output. Raises what `Output.begin` raises."""
        self.output.begin(self.on)

    @property
    def moving(self) -> bool:
        """Whether its driver has still to confirm that."""
        return self.output.waiting

    def problem(self, _: str) -> Problem | None:
        """Why the goal cannot go on; None if it can."""
        return self.output.problem

    def cancel(self, why: str) -> None:
        """Wait no longer."""
        self.output.cancel(why)
