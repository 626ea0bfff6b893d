"""The `zarm` executable as a user runs it, and the processes that it starts or leaves behind."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import uuid
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

import psutil

from support.forks import run_command
from support.harness import PATIENCE, eventually
from zarm_contract.errors import Unavailable
from zarm_contract.keys import Keys
from zarm_contract.messages import Health, Nothing
from zarm_runtime.bus import Bus

ZARM = str(Path(sys.executable).with_name("zarm"))
ROBOT = "doosan_m1013"
KEYS = Keys(ROBOT)
HOME = (0.0, 0.0, 1.5707963, 0.0, 1.5707963, 0.0)
SERVICES = ("planner", "servo", "executor")
_MARK = "ZARM_TEST_MARK"


def environment(**variables: str) -> dict[str, str]:
    """This process's environment without settings of zarm, plus `variables`."""
    return {key: value for key, value in os.environ.items() if not key.startswith("ZARM_")} | variables


def zarm(*arguments: str, timeout: float = PATIENCE, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run `zarm` to its end; `variables` are added to its environment. It is forked from a process that has imported
    it, unless a variable is not of zarm: that may be read during the import.
    """
    command, its_environment = [ZARM, *arguments], environment(**variables)
    if all(name.startswith("ZARM_") for name in variables):
        return run_command(command, its_environment, timeout)
    return subprocess.run(command, env=its_environment, capture_output=True, text=True, timeout=timeout)


def the_one_line(text: str) -> str:
    """The text, which must be one line."""
    lines = text.splitlines()
    assert len(lines) == 1, text
    return lines[0]


def done(up: Up, *arguments: str) -> str:
    """Standard output of a command that must succeed."""
    result = zarm(*arguments, ZARM_CONNECT=up.endpoint)
    assert result.returncode == 0, f"{arguments}: {result.stderr}"
    return result.stdout


def data(up: Up, *arguments: str) -> Any:
    """The output of a command with --json, parsed."""
    return json.loads(the_one_line(done(up, *arguments, "--json")))


def refused(up: Up, *arguments: str, code: int = 1) -> str:
    """The one line of a command that must fail with this exit code."""
    result = zarm(*arguments, ZARM_CONNECT=up.endpoint)
    assert result.returncode == code, f"{arguments}: {result.stdout}{result.stderr}"
    return the_one_line(result.stderr)


def vector(values: tuple[float, ...]) -> str:
    """Numbers in the form of a command argument."""
    return ",".join(f"{value:.6f}" for value in values)


class Command:
    """A `zarm` command that runs until it ends or is signalled. Leaving kills whatever is left of it."""

    def __init__(self, *arguments: str, folder: Path, stdin: int | None = None, **variables: str) -> None:
        self._stdin = stdin
        self._mark = uuid.uuid4().hex
        self._arguments = [ZARM, *arguments]
        self.variables = environment(**variables)
        self._environment = self.variables | {_MARK: self._mark}
        self._output = folder / f"{self._mark}.out"
        self._errors = folder / f"{self._mark}.err"

    def __enter__(self) -> Self:
        with self._output.open("wb") as out, self._errors.open("wb") as err:
            self.process = subprocess.Popen(
                self._arguments,
                env=self._environment,
                stdin=self._stdin,
                stdout=out,
                stderr=err,
                start_new_session=True,
            )
        return self

    def __exit__(self, *_: object) -> None:
        for process in [self.process, *self.family()]:
            process.kill()
        self.process.wait()

    def family(self) -> list[psutil.Process]:
        """Every living descendant process, whatever its present parent."""
        return [
            process for process in psutil.process_iter() if process.pid != self.process.pid and self._is_mine(process)
        ]

    def _is_mine(self, process: psutil.Process) -> bool:
        try:
            return process.environ().get(_MARK) == self._mark
        except psutil.Error:  # ended meanwhile, or another user's
            return False

    def command_lines(self) -> list[list[str]]:
        """The command lines of the family."""
        lines = []
        for process in self.family():
            with suppress(psutil.Error):
                lines.append(process.cmdline())
        return lines

    def output(self) -> str:
        """The output so far."""
        return self._output.read_text(errors="replace")

    def errors(self) -> str:
        """Standard error so far, including the logs of its services."""
        return self._errors.read_text(errors="replace")

    def wait_for(self, text: str) -> None:
        """Wait until it has printed `text`; fails if it ends before."""

        def printed() -> bool:
            ended = self.process.poll() is not None
            if text in self.output():
                return True
            assert not ended, f"ended with {self.process.returncode} before {text!r}:\n{self.output()}{self.errors()}"
            return False

        eventually(printed, f"{text!r} is printed")

    def interrupt(self, number: int = signal.SIGINT) -> None:
        """Signal the command itself, not its family."""
        self.process.send_signal(number)

    def end(self, timeout: float = PATIENCE) -> int:
        """Wait for its end; returns the exit code."""
        return self.process.wait(timeout)


class Up(Command):
    """`zarm up`, ready on entry; leaving ends it with Ctrl-C."""

    def __init__(
        self, endpoint: str, folder: Path, *arguments: str, joins: bool = False, name: str = ROBOT, **variables: str
    ) -> None:
        self.endpoint = endpoint
        self.keys = Keys(name)
        where = ("--connect" if joins else "--listen", endpoint, "--state", str(folder / "state"), "--name", name)
        super().__init__("up", *where, *arguments, folder=folder, **variables)

    def __enter__(self) -> Self:
        super().__enter__()
        try:
            self.wait_for("Ctrl-C")
        except AssertionError:
            super().__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            self.interrupt()
            self.end()
        super().__exit__()


class Router(Command):
    """`zarm router`, listening on entry; leaving ends it with SIGTERM and checks that it ends properly."""

    def __init__(self, folder: Path, *arguments: str, **variables: str) -> None:
        super().__init__("router", *arguments, folder=folder, **variables)

    def __enter__(self) -> Self:
        super().__enter__()
        self.wait_for("Ctrl-C")
        return self

    def __exit__(self, *_: object) -> None:
        try:
            if self.process.poll() is None:
                self.interrupt(signal.SIGTERM)
                assert self.end() == 0, self.errors()
        finally:
            super().__exit__()


def health(bus: Bus, service: str, keys: Keys = KEYS) -> Health | None:
    """The health of a service, or None while it does not answer."""
    try:
        return bus.call(keys.health(service), Nothing(), timeout=5)
    except Unavailable:
        return None


def pid(bus: Bus, service: str) -> int:
    """The process id of a service that is ready."""
    found = eventually(lambda: health(bus, service), f"the {service} answers")
    return found.pid


def wait_replaced(bus: Bus, service: str, old: int) -> Health:
    """Wait until another process has replaced the process `old`."""

    def replaced() -> Health | None:
        found = health(bus, service)
        return found if found is not None and found.ready and found.pid != old else None

    return eventually(replaced, f"the {service} runs again")
