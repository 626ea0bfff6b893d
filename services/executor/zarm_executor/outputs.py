"""The digital outputs of a robot: they are switched through its driver, which confirms it."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

from zarm_contract.errors import Busy, Code, InvalidRequest, Problem, Unavailable, from_problem
from zarm_contract.keys import Keys
from zarm_contract.messages import DriverOutputCommand, DriverOutputState, OutputRequest, OutputState
from zarm_contract.robot import RobotDescription
from zarm_contract.strategies import DRIVER_STRATEGIES
from zarm_runtime import clock
from zarm_runtime.bus import Bus, Publisher

log = logging.getLogger(__name__)


class Output:
    """One output, switched as the active strategy moves the robot. Thread-safe."""

    def __init__(
        self,
        name: str,
        timeout: float,
        commands: Publisher[DriverOutputCommand],
        report: Callable[[OutputState], object],
    ) -> None:
        self.name, self._timeout, self._commands, self._report = name, timeout, commands, report
        self._state = OutputState(output=name)
        self._strategy = ""
        self._sequence, self._wanted, self._due = 0, False, 0.0
        self._waiting = False
        self._changed = threading.Condition()
        report(self._state)

    def switch(self, strategy: str) -> None:
        """From now on be switched as this strategy moves the robot."""
        with self._changed:
            self._strategy = strategy
            self._end(f"the strategy was switched to {strategy}")

    def begin(self, on: bool) -> None:
        """Command it. Raises Busy while another command is not confirmed, and Unavailable where the strategy moves no robot."""
        with self._changed:
            if self._waits(clock.monotonic()):
                raise Busy(f"{self.name} is being switched for another client; try again")
            self._wanted = on
            if self._strategy == "emulator":
                self._settle(OutputState(output=self.name, on=on))
                return
            if self._strategy not in DRIVER_STRATEGIES:
                raise Unavailable(
                    f"the strategy {self._strategy} switches no outputs; choose emulator, or one that moves the robot"
                )
            self._sequence += 1
            self._waiting, self._due = True, clock.monotonic() + self._timeout
            command = DriverOutputCommand(output=self.name, sequence=self._sequence, on=on)
        self._commands.put(command)

    @property
    def waiting(self) -> bool:
        """Whether the driver has still to confirm the last command."""
        with self._changed:
            return self._waits(clock.monotonic())

    def wait(self) -> OutputState:
        """The state of an output once the driver has confirmed the last command, or has failed to in time."""
        with self._changed:
            while self._waits(clock.monotonic()):
                self._changed.wait(clock.real_seconds(max(self._due - clock.monotonic(), 0.0)))
            return self._state

    @property
    def problem(self) -> Problem | None:
        """What became of the last command, if it was not carried out."""
        with self._changed:
            return self._state.problem

    def cancel(self, why: str) -> None:
        """Wait no longer for the driver."""
        with self._changed:
            self._end(why)

    def receive(self, reported: DriverOutputState) -> None:
        """Take what the driver says."""
        with self._changed:
            if not self._waiting or reported.sequence != self._sequence:
                return
            self._waiting = False
            if reported.problem is None:
                self._settle(OutputState(output=self.name, on=self._wanted))
            else:
                self._fail("driver_stalled", f"{self.name} was not switched: {reported.problem}")

    def _waits(self, now: float) -> bool:
        if self._waiting and now >= self._due:
            self._waiting = False
            self._fail(
                "driver_stalled",
                f"the driver did not confirm {self.name} within {self._timeout:g} s; see whether it runs, or raise driver_timeout",
            )
        return self._waiting

    def _end(self, why: str) -> None:
        if self._waiting:
            self._waiting = False
            self._fail("cancelled", f"{self.name} was not confirmed: {why}")

    def _fail(self, code: Code, why: str) -> None:
        self._settle(OutputState(output=self.name, on=self._state.on, problem=Problem(code=code, message=why)))

    def _settle(self, state: OutputState) -> None:
        self._state = state
        self._changed.notify_all()
        self._report(state)
        reason = "" if state.problem is None else f" reason={state.problem.message}"
        log.info("output output=%s on=%s%s", self.name, state.on, reason)


class Outputs:
    """All outputs of a robot; it may have none. A stop leaves them as they are."""

    def __init__(self, robot: RobotDescription, strategy: str, bus: Bus, keys: Keys) -> None:
        states, commands = bus.latched(keys.output_state("*")), bus.publisher(keys.driver_output_command)
        self._outputs = {
            name: Output(
                name,
                output.driver_timeout,
                commands,
                lambda state: states.set(state, key=keys.output_state(state.output)),
            )
            for name, output in robot.descriptor.outputs.items()
        }
        self.switch(strategy)
        bus.subscribe(keys.driver_output_state, self._receive)

    def named(self, name: str) -> Output:
        """One of them. Raises InvalidRequest if it is not there."""
        if not self._outputs:
            raise InvalidRequest(
                "this robot has no outputs; describe them in `outputs` of its descriptor", field="output"
            )
        if name not in self._outputs:
            raise InvalidRequest(
                f"there is no output {name}; this robot has {', '.join(self._outputs)}", field="output"
            )
        return self._outputs[name]

    def set(self, request: OutputRequest) -> OutputState:
        """Switch one, and wait until its driver confirms it. Raises a ZarmError if it does not."""
        output = self.named(request.output)
        output.begin(request.on)
        state = output.wait()
        if state.problem is not None:
            raise from_problem(state.problem)
        return state

    def switch(self, strategy: str) -> None:
        """From now on switch them as this strategy moves the robot."""
        for output in self._outputs.values():
            output.switch(strategy)

    def _receive(self, _: str, state: DriverOutputState) -> None:
        if state.output in self._outputs:
            self._outputs[state.output].receive(state)
