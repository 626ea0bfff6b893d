"""Services and commands forked from a process that has imported them and loaded their kernels: real processes for a
fraction of the CPU time.
"""

from __future__ import annotations

import atexit
import ctypes
import json
import os
import select
import signal
import socket
import subprocess
import sys
import threading
from functools import cache
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import TextIO

from support.programs import fork_server
from zarm_cli.commands import MODULES

IMPORTED_ALONE = ("planner", "servo", "executor", "leeloo_sim")
"""The services that start no thread when imported."""

_PR_SET_CHILD_SUBREAPER = 36
_ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1"}


class Forked:
    """A child process with the interface of `subprocess.Popen`."""

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self.returncode: int | None = None

    def poll(self) -> int | None:
        """The exit code, negative if a signal ended it; None while it runs."""
        if self.returncode is None:
            ended, status = os.waitpid(self.pid, os.WNOHANG)
            if ended:
                self.returncode = os.waitstatus_to_exitcode(status)
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """The exit code, once it has ended. Raises TimeoutExpired."""
        if self.poll() is None:
            end = os.pidfd_open(self.pid)
            ended, *_ = select.select([end], [], [], timeout)
            os.close(end)
            if not ended:
                raise subprocess.TimeoutExpired(f"process {self.pid}", timeout or 0.0)
        code = self.poll()
        assert code is not None
        return code

    def send_signal(self, number: int) -> None:
        """Signal it, unless it has ended."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def terminate(self) -> None:
        """Send SIGTERM."""
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """Send SIGKILL."""
        self.send_signal(signal.SIGKILL)


def fork_service(service: str, command: list[str], environment: dict[str, str], log: Path) -> Forked:
    """The process that `command`, `python -m` and the service, would start."""
    return _fork((f"zarm_{service}.service",), command, environment, str(log), str(log))


def run_command(command: list[str], environment: dict[str, str], timeout: float) -> subprocess.CompletedProcess[str]:
    """The result of `command`, the path of `zarm` and its arguments. Raises TimeoutExpired after killing it."""
    with NamedTemporaryFile("r") as output, NamedTemporaryFile("r") as errors:
        process = _fork(_COMMAND_LINE, [sys.executable, *command], environment, output.name, errors.name)
        try:
            code = process.wait(timeout)
        except BaseException:
            process.kill()
            process.wait()
            raise
        return subprocess.CompletedProcess(command, code, output.read(), errors.read())


def _fork(
    modules: tuple[str, ...], command: list[str], environment: dict[str, str], output: str, errors: str
) -> Forked:
    """`modules`: that of the program, then those that it imports late."""
    request = {
        "command": command,
        "environment": environment,
        "folder": str(Path.cwd()),
        "output": output,
        "errors": errors,
        "scheduling": (os.sched_getscheduler(0), os.sched_getparam(0).sched_priority),
    }
    with _LOCK:
        server = _server(modules)
        _PRCTL(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
        try:
            server.write(json.dumps(request) + "\n")
            server.flush()
            return Forked(int(server.readline()))
        finally:
            _PRCTL(_PR_SET_CHILD_SUBREAPER, 0, 0, 0, 0)


_COMMAND_LINE = ("zarm_cli.app", *sorted({f"zarm_cli.{module}" for module in MODULES.values()}))
_LOCK = threading.Lock()
_PRCTL = ctypes.CDLL(None).prctl


@cache
def _server(modules: tuple[str, ...]) -> TextIO:
    """The connection to the fork server of a program, which ends with this process."""
    here, there = socket.socketpair()
    with here, there:
        command = [sys.executable, str(fork_server.__file__), str(there.fileno()), *modules]
        server = subprocess.Popen(
            command,
            env=os.environ | _ONE_THREAD,
            stdout=subprocess.DEVNULL,
            pass_fds=[there.fileno()],
            start_new_session=True,
        )
        connection = here.makefile("rw")
    atexit.register(server.wait)
    atexit.register(connection.close)
    return connection
