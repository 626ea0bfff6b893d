"""A link between one process and the router that can be cut: hard, or silently.

A separate process carries the data, because activity in the test's own, such as garbage collection, would delay it.
"""

from __future__ import annotations

import multiprocessing
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection

from support.harness import free_endpoint

_RESET = struct.pack("ii", 1, 0)
"""SO_LINGER with which a socket is closed by a reset instead of orderly."""


def _address(endpoint: str) -> tuple[str, int]:
    host, port = endpoint.removeprefix("tcp/").rsplit(":", 1)
    return host, int(port)


class Link:
    """Forwards what arrives at `endpoint` to the router, and back."""

    def __init__(self, endpoint: str, control: Connection) -> None:
        self.endpoint = endpoint
        self._control = control

    def cut(self) -> None:
        """Reset every connection, and each new one at once."""
        self._tell("cut")

    def swallow(self) -> None:
        """Drop everything silently, like an unplugged cable."""
        self._tell("swallow")

    def restore(self) -> None:
        """Forward everything again; swallowed data arrives now, as with TCP."""
        self._tell("restore")

    def _tell(self, order: str) -> None:
        self._control.send(order)
        self._control.recv()


@contextmanager
def link(router: str, enter: Callable[[], None] | None = None) -> Iterator[Link]:
    """A link to the router, until the end of the block; `enter` moves a thread to where the router is."""
    here, there = multiprocessing.Pipe()
    endpoint = free_endpoint()
    process = multiprocessing.get_context("spawn").Process(target=_carry, args=(endpoint, router, enter, there))
    process.start()
    there.close()
    try:
        here.recv()  # it listens
        yield Link(endpoint, here)
    finally:
        process.terminate()
        process.join()
        process.close()
        here.close()


def _carry(endpoint: str, router: str, enter: Callable[[], None] | None, control: Connection) -> None:
    carrier = _Carrier(endpoint, router, enter)
    control.send(None)
    with suppress(EOFError):  # the test has ended without a word
        while True:
            getattr(carrier, control.recv())()
            control.send(None)


class _Carrier:
    def __init__(self, endpoint: str, router: str, enter: Callable[[], None] | None) -> None:
        self._router = _address(router)
        self._enter = enter
        self._listener = socket.create_server(_address(endpoint))
        self._ends: list[socket.socket] = []
        self._lock = threading.Lock()
        self._whole = True
        self._flows = threading.Event()
        self._flows.set()
        threading.Thread(target=self._accept, daemon=True).start()

    def cut(self) -> None:
        with self._lock:
            self._whole = False
            ends, self._ends = self._ends, []
        for end in ends:
            end.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET)
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
            end.close()

    def swallow(self) -> None:
        self._flows.clear()

    def restore(self) -> None:
        self._whole = True
        self._flows.set()

    def _accept(self) -> None:
        if self._enter is not None:
            self._enter()
        with suppress(OSError):
            while True:
                self._join(self._listener.accept()[0])

    def _join(self, near: socket.socket) -> None:
        try:
            far = socket.create_connection(self._router)
        except OSError:  # no router
            near.close()
            return
        with self._lock:
            if not self._whole:
                near.close()
                far.close()
                return
            self._ends += [near, far]
        for source, sink in ((near, far), (far, near)):
            source.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            threading.Thread(target=self._pump, args=(source, sink), daemon=True).start()

    def _pump(self, source: socket.socket, sink: socket.socket) -> None:
        with suppress(OSError):
            while data := source.recv(65536):
                self._flows.wait()
                sink.sendall(data)
        for end in (source, sink):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
