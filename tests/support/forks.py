"""Services that begin as forks of a process which has imported them and loaded their kernels: real processes for a fraction of the CPU."""

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
from typing import TextIO

from support.programs import fork_server

IMPORTED_ALONE = ("planner", "servo", "executor", "leeloo_sim")
"""The services that start no thread when they are imported."""

_PR_SET_CHILD_SUBREAPER = 36
_ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1"}


class Forked:
    """A child process, as `subprocess.Popen` shows one."""

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self.returncode: int | None = None

    def poll(self) -> int | None:
        """The exit code, negative where a signal ended it; None while it runs."""
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


def fork(service: str, command: list[str], environment: dict[str, str], log: Path) -> Forked:
    """What `command`, which is `python -m` and the service, would start."""
    scheduling = os.sched_getscheduler(0), os.sched_getparam(0).sched_priority
    request = {
        "command": command,
        "environment": environment,
        "folder": str(Path.cwd()),
        "log": str(log),
        "scheduling": scheduling,
    }
    with _LOCK:
        server = _server(f"zarm_{service}")
        _PRCTL(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
        try:
            server.write(json.dumps(request) + "\n")
            server.flush()
            return Forked(int(server.readline()))
        finally:
            _PRCTL(_PR_SET_CHILD_SUBREAPER, 0, 0, 0, 0)


_LOCK = threading.Lock()
_PRCTL = ctypes.CDLL(None).prctl


@cache
def _server(package: str) -> TextIO:
    """The connection to the server of a service, which ends with this process."""
    here, there = socket.socketpair()
    with here, there:
        command = [sys.executable, str(fork_server.__file__), package, str(there.fileno())]
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
