"""Real routers and real service processes for tests, on free loopback ports."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, Self, TypeVar

from support.forks import IMPORTED_ALONE, Forked, fork_service
from zarm_contract.errors import Unavailable
from zarm_contract.keys import Keys
from zarm_contract.messages import Health, Nothing
from zarm_runtime.bus import Bus
from zarm_runtime.session import open_router

T = TypeVar("T")

PATIENCE = 60.0
"""Seconds until a test gives up waiting for an event; not a claim about speed."""
SOON, LATE = 0.005, 0.05
"""Intervals (s) at which an event is checked, at first and after a second."""


def free_endpoint() -> str:
    """A loopback endpoint whose port was free a moment ago."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


@contextmanager
def router() -> Iterator[str]:
    """A router in this process; yields its endpoint."""
    endpoint = free_endpoint()
    session = open_router(endpoint)
    try:
        yield endpoint
    finally:
        session.close()


def eventually(probe: Callable[[], T | None], what: str, patience: float = PATIENCE) -> T:
    """The first truthy value of `probe()`; fails the test if there is none in time.

    The longer it waits, the less often it checks, because a probe may burden the very service that it waits for.
    """
    began = time.monotonic()
    while not (value := probe()):
        waited = time.monotonic() - began
        if waited > patience:
            raise AssertionError(f"waited {patience:g} s in vain until {what}")
        time.sleep(min(SOON + 0.05 * waited, LATE))
    return value


def nothing_compiled(folder: Path) -> dict[str, str]:
    """Variables with which a process has to compile all its kernels, into this folder: those of the cache beside the code, which
    the folder starts with, are for another processor.
    """
    return {"NUMBA_CACHE_DIR": str(folder / "kernels"), "NUMBA_CPU_NAME": "generic"}


@dataclass
class ServiceProcess:
    """One service of zarm as a separate process; use it in `with`. Leaving stops it with SIGTERM and waits.

    `script` is run instead; `prefix` is put before the command; `environment` is added to that of the tests, and is the
    place for variables read when a service is imported. Without these it is forked from a process that has imported it.
    `started` are those of the present test, including ended ones.
    """

    started: ClassVar[list[ServiceProcess]] = []
    service: str
    endpoint: str
    state: Path
    robot: str = "doosan_m1013"
    name: str | None = None
    arguments: tuple[str, ...] = ()
    script: str | None = None
    environment: dict[str, str] = field(default_factory=dict)
    prefix: tuple[str, ...] = ()

    def __enter__(self) -> Self:
        program = [self.script] if self.script else ["-m", f"zarm_{self.service}.service"]
        command = [*self.prefix, sys.executable, *program, "--robot", self.robot]
        command += ["--connect", self.endpoint, "--state", str(self.state)]
        command += [*(["--name", self.name] if self.name else []), *self.arguments]
        self.log = self.state / f"{self.service}-{time.monotonic_ns()}.log"
        environment = os.environ | self.environment
        with self.log.open("wb") as log:
            self.process: subprocess.Popen[bytes] | Forked
            if self.service in IMPORTED_ALONE and not (self.script or self.prefix or self.environment):
                self.process = fork_service(self.service, command, environment, self.log)
            else:
                self.process = subprocess.Popen(
                    command, stdout=log, stderr=log, start_new_session=True, env=environment
                )
        self.started.append(self)
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGCONT)
            self.process.terminate()
        try:
            self.process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
            raise AssertionError(f"{self.service} did not end on SIGTERM; its log:\n{self.output()}") from None

    def output(self) -> str:
        """The log of the process so far."""
        return self.log.read_text(errors="replace")

    def kill(self) -> None:
        """End it as in a crash."""
        os.kill(self.process.pid, signal.SIGKILL)
        self.process.wait()

    def wait_ready(self, bus: Bus, keys: Keys) -> Health:
        """Wait until exactly this process reports that it is ready."""

        def ready() -> Health | None:
            if self.process.poll() is not None:
                raise AssertionError(f"{self.service} ended with {self.process.returncode}; its log:\n{self.output()}")
            try:
                health = bus.call(keys.health(self.service), Nothing(), timeout=5)
            except Unavailable:
                return None
            return health if health.ready and health.pid == self.process.pid else None

        return eventually(ready, f"{self.service} is ready")
