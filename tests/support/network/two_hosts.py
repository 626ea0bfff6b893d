"""Two machines on one: network namespaces as hosts, a wire between them, a router on each, and a planner and a robot.

    workstation 10.77.0.1            robot 10.77.0.2
    router, planner      ── wire ──  router, executor, driver

The routers are linked by the workstation's. It takes Linux, root, iproute2 and /dev/net/tun; `obstacle()` says what is missing.
"""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path

from support.command_line import ZARM, environment
from support.harness import ServiceProcess, eventually
from support.network.link import link
from support.network.wire import Wire, wire
from zarm_contract.errors import Unavailable
from zarm_runtime.bus import Bus

PORT = 7447
SECURITY = ("ZARM_SECURITY", "ZARM_CERTS")
"""Variables of the tests' own environment that apply on every host."""
LOCAL = f"tcp/127.0.0.1:{PORT}"
"""The router of a host, as its own processes see it."""


def obstacle() -> str | None:
    """Why this machine cannot simulate two, or None."""
    if shutil.which("ip") is None:
        return "two hosts need iproute2 (apt-get install iproute2)"
    if not Path("/dev/net/tun").exists():
        return "two hosts need /dev/net/tun"
    tried = subprocess.run(["unshare", "--net", "true"], capture_output=True)
    return None if tried.returncode == 0 else "two hosts need root, for network namespaces"


def _ip(*words: str) -> None:
    done = subprocess.run(["ip", *words], capture_output=True, text=True)
    assert done.returncode == 0, f"ip {' '.join(words)}: {done.stderr}"


def _environment() -> dict[str, str]:
    return environment(**{name: os.environ[name] for name in SECURITY if name in os.environ})


def enter(namespace: str) -> None:
    """Whatever the calling thread opens from now on, and each thread that it starts, is in this network namespace."""
    with Path("/run/netns", namespace).open() as file:
        failed = ctypes.CDLL(None, use_errno=True).setns(file.fileno(), 0)
    assert not failed, os.strerror(ctypes.get_errno())


class Host:
    """A network namespace with a router. `bus` is a session on that router for the test, `endpoint` the way to it."""

    def __init__(self, stack: ExitStack, name: str, address: str, folder: Path) -> None:
        self.namespace = f"zarm-{os.getpid()}-{name}"
        self.address = address
        self.folder = folder / name
        self.folder.mkdir()
        self._stack = stack
        _ip("netns", "add", self.namespace)
        stack.callback(_ip, "netns", "del", self.namespace)
        _ip("-n", self.namespace, "link", "set", "lo", "up")
        self.endpoint = stack.enter_context(link(LOCAL, partial(enter, self.namespace))).endpoint
        self.bus: Bus

    def plug_in(self, device: str, peer: str) -> None:
        """Connect it to one end of a wire; at the other end is the address `peer`."""
        _ip("link", "set", device, "netns", self.namespace)
        _ip("-n", self.namespace, "address", "add", self.address, "peer", peer, "dev", device)
        _ip("-n", self.namespace, "link", "set", device, "up")

    def run(self, *command: str) -> list[str]:
        """The command line that runs a command on this host."""
        return ["ip", "netns", "exec", self.namespace, *command]

    def start_router(self, *arguments: str) -> None:
        """Run `zarm router` until the hosts are gone; waits until it answers."""
        process = self._stack.enter_context(self.runs(ZARM, "router", *arguments))
        self._stack.callback(process.wait)
        self._stack.callback(process.terminate)

        def joined() -> Bus | None:
            assert process.poll() is None, f"the router ended with {process.returncode}"
            try:
                return Bus(self.endpoint, timeout=1.0)
            except Unavailable:
                return None

        self.bus = self._stack.enter_context(eventually(joined, f"the router of {self.namespace} answers"))

    def service(
        self, name: str, *arguments: str, robot: str = "doosan_m1013", called: str | None = None
    ) -> ServiceProcess:
        """A service of zarm on this host; use it in `with`."""
        return ServiceProcess(name, LOCAL, self.folder, robot, called, arguments, prefix=tuple(self.run()))

    @contextmanager
    def runs(self, *command: str) -> Iterator[subprocess.Popen[bytes]]:
        """Run a command on this host; what is left of it at the end of the block is killed."""
        process = subprocess.Popen(self.run(*command), env=_environment(), start_new_session=True)
        try:
            yield process
        finally:
            process.kill()
            process.wait()

    def zarm(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        """Run `zarm` on this host to its end."""
        return subprocess.run(
            self.run(ZARM, *arguments), env=_environment(), capture_output=True, text=True, timeout=60
        )


class Hosts:
    """Both hosts, and the `wire` between them."""

    def __init__(self, stack: ExitStack, folder: Path) -> None:
        self.workstation = Host(stack, "workstation", "10.77.0.1", folder)
        self.robot = Host(stack, "robot", "10.77.0.2", folder)
        self.wire: Wire = stack.enter_context(wire())
        for device, host, peer in zip(self.wire.ends, self, reversed(list(self)), strict=True):
            host.plug_in(device, peer.address)
        self.robot.start_router("--listen", f"tcp/0.0.0.0:{PORT}")
        self.workstation.start_router("--listen", LOCAL, "--link", f"tcp/{self.robot.address}:{PORT}")

    def __iter__(self) -> Iterator[Host]:
        return iter((self.workstation, self.robot))


@contextmanager
def hosts(folder: Path) -> Iterator[Hosts]:
    """Two hosts with linked routers, until the end of the block."""
    with ExitStack() as stack:
        yield Hosts(stack, folder)
