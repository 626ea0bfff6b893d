"""The digital outputs of a robot: valves, lamps, a welding torch."""

from __future__ import annotations

from collections.abc import Generator, Mapping

from zarm.calls import Calls
from zarm.connection import ANSWER_SECONDS
from zarm.values import made
from zarm_contract.messages import MAX_OUTPUT_TIMEOUT, OutputRequest, OutputState


class Outputs(Calls):
    """Switches the outputs of a robot, which its descriptor names, and reads how they were switched."""

    def set(self, output: str, on: bool) -> OutputState:
        """Switch an output `on` or off, and wait until its driver has done so.

        Raises InvalidRequest for one that is not there, Busy while it is being switched, and ExecutionFailed if the driver does not confirm it.
        """
        longest = MAX_OUTPUT_TIMEOUT + ANSWER_SECONDS
        return self._ask(self._keys.output, made(OutputRequest, output=output, on=on), timeout=longest)

    def all(self) -> Mapping[str, OutputState]:
        """Each output by name, as it was switched last."""
        found: dict[str, OutputState] = {}

        def read() -> None:
            self.connection.bus.watch(
                self._keys.output_state("*"), lambda _, state: found.update({state.output: state})
            )()

        self.connection.interrupts.run_interruptibly(read)
        return found

    def states(self, output: str = "*") -> Generator[OutputState]:
        """How an output, or each, was switched last, then every change; endless."""
        return self.connection.latched(self._keys.output_state(output))
