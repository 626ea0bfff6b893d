"""Keeps service processes running with supervisord: restart with back-off, stop in order, leave nothing behind.

supervisord runs as a child with its own configuration in a temporary folder. It polls once a second, so a process that
died is restarted after about 1 s; starting and stopping do not wait for the poll, because a call on its socket wakes
it. It and the services are on leashes (`zarm_cli.end_with_parent`): whatever ends the launcher ends them too.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import socket
import subprocess
import sys
import tempfile
import threading
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self
from xmlrpc.client import ServerProxy

from supervisor.states import ProcessStates
from supervisor.xmlrpc import SupervisorTransport

from zarm_contract.errors import InternalError

_STOP_SECONDS = 15  # for one process, deceleration included; then it is killed
_ENDED = re.compile(r" exited: (\w+) \((.+?)(?:; .+)?\)\n")  # the format of supervisord's log
_RETRIES = 6  # consecutive failed starts, with 1 s, 2 s, ... between them

_HEAD = """\
[supervisord]
nodaemon = true
silent = true
logfile = {folder}/supervisord.log
pidfile = {folder}/supervisord.pid
minfds = 64
minprocs = 1

[unix_http_server]
file = {folder}/socket

[rpcinterface:supervisor]
supervisor.rpcinterface_factory = supervisor.rpcinterface:make_main_rpcinterface
"""

# The program with the higher priority is started later and stopped earlier.
_PROGRAM = """
[program:{name}]
command = {command}
priority = {priority}
autorestart = true
startsecs = 5
startretries = {retries}
stopwaitsecs = {stop_seconds}
redirect_stderr = true
stdout_logfile = /dev/fd/1
stdout_logfile_maxbytes = 0
"""


_ERROR = re.compile(r"[\w.]*(Error|Exception)\b")  # the end of a Python traceback


def _reason(name: str, lines: Iterable[str]) -> str | None:
    """The first reason in a line of this program's log, as text or as JSON."""
    own = re.compile(rf"(\x1b\[\d+m)?{name} *\| .*?\breason=(?P<reason>.*)")
    for line in lines:
        if found := own.match(line):
            return found["reason"]
        if line.startswith("{"):
            entry = json.loads(line)
            if entry.get("service") == name and "reason" in entry.get("fields", {}):
                return str(entry["fields"]["reason"])
    return None


def _command(module: str, arguments: Sequence[str]) -> list[str]:
    return [sys.executable, "-P", "-m", "zarm_cli.end_with_parent", module, *arguments]


class Supervisor:
    """Modules that run as programs, `{name: (module, arguments)}`: started in this order, stopped in reverse.

    Use it in `with`; leaving stops them all. Their output goes to standard error.
    """

    def __init__(self, programs: Mapping[str, tuple[str, Sequence[str]]], environment: Mapping[str, str]) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="zarm-")
        folder = Path(self._folder.name)
        config = _HEAD.format(folder=self._folder.name.replace("%", "%%"))
        for priority, (name, (module, arguments)) in enumerate(programs.items(), start=1):
            command = shlex.join(_command(module, arguments)).replace("%", "%%")
            config += _PROGRAM.format(
                name=name, command=command, priority=priority, retries=_RETRIES, stop_seconds=_STOP_SECONDS
            )
        (folder / "supervisord.conf").write_text(config)
        self._socket = folder / "socket"
        self._names = tuple(programs)
        self._environment = {**os.environ, **environment}
        self._read = 0
        self._last_lines: deque[str] = deque(maxlen=100)

    def __enter__(self) -> Self:
        command = _command("supervisor.supervisord", ["-c", f"{self._folder.name}/supervisord.conf"])
        self._process = subprocess.Popen(  # noqa: S603 - our own interpreter
            command,
            env=self._environment,
            stdin=subprocess.PIPE,  # the leash
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,  # Ctrl-C in the terminal reaches only the launcher
        )
        self._relay = threading.Thread(target=self._relay_output, daemon=True)
        self._relay.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.terminate()
        self._wake()
        try:
            self._process.wait(_STOP_SECONDS * (len(self._names) + 1))
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._relay.join()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()
        self._folder.cleanup()

    def ended(self) -> list[tuple[str, str]]:
        """Programs that have ended by themselves since the last call, and how: `exit status 1`, `terminated by
        SIGKILL`.
        """
        with suppress(FileNotFoundError), Path(self._folder.name, "supervisord.log").open() as log:
            log.seek(self._read)
            text = log.read()
            whole = text[: text.rfind("\n") + 1]
            self._read += len(whole.encode())
            return _ENDED.findall(whole)
        return []

    def fallen(self) -> list[str]:
        """Names of the programs that have ended by themselves at least once, whether they run again or not."""
        return [process["name"] for process in self._processes() if process["stop"]]

    def given_up(self) -> list[str]:
        """Names of the programs that failed too often in a row and are not restarted."""
        return [process["name"] for process in self._processes() if process["state"] == ProcessStates.FATAL]

    def last_words(self, name: str) -> str:
        """Why a program ended: the reason in its own log (as `zarm_runtime.service` writes it); otherwise the error
        that ended a program before it had a log; otherwise its last line.
        """
        self._relay.join(0.2)  # its last output may still be on its way
        lines = list(self._last_lines)[::-1]
        return _reason(name, lines) or next(filter(_ERROR.match, lines), None) or (lines or ["it printed nothing"])[0]

    def _processes(self) -> Any:
        if self._process.poll() is not None:
            raise InternalError(f"supervisord ended with {self._process.returncode}; its last lines are above")
        try:
            with self._server() as server:
                return server.supervisor.getAllProcessInfo()
        except (FileNotFoundError, ConnectionError):  # it does not listen yet, or is about to end
            return []

    def _server(self) -> Any:
        return ServerProxy("http://localhost", transport=SupervisorTransport(None, None, f"unix://{self._socket}"))

    def _wake(self) -> None:
        with suppress(OSError), socket.socket(socket.AF_UNIX) as connection:  # it may have ended
            connection.settimeout(1.0)
            connection.connect(str(self._socket))

    def _relay_output(self) -> None:
        output = self._process.stdout
        if output is None:
            return
        for line in output:
            with suppress(OSError):  # nobody reads our standard error any more; supervisord must not block on us
                sys.stderr.buffer.write(line)
                sys.stderr.buffer.flush()
            self._last_lines.append(line.decode(errors="replace").strip())
