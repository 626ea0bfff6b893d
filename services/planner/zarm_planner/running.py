"""The work in hand: how much of it runs at once, and how it is ended before its time."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from zarm_contract.errors import Cancelled, Unavailable
from zarm_planner.stop import Stop

T = TypeVar("T")

_POLL = 0.02
"""Seconds between looks at the stop of work that waits for its turn."""


class Running:
    """Runs as much work at a time as there are `slots`; what waits for its turn has its deadline and can be cancelled."""

    def __init__(self, slots: int) -> None:
        self._pool = ThreadPoolExecutor(slots, thread_name_prefix="planning")
        self._lock = threading.Lock()
        self._stops: dict[Stop, str | None] = {}
        self._closed = False

    def run(self, work: Callable[[Stop], T], timeout: float, request_id: str | None = None) -> T:
        """The result of `work(stop)`, which must look at its stop. Raises Unavailable once the service ends."""
        stop = Stop(timeout)
        with self._lock:
            if self._closed:
                raise _ending()
            self._stops[stop] = request_id
            future = self._pool.submit(work, stop)
        try:
            while True:
                try:
                    return future.result(_POLL)
                except TimeoutError:
                    if stop.passed and future.cancel():
                        stop.check()
        except Cancelled as error:
            if self._closed:
                raise _ending() from error
            raise
        finally:
            with self._lock:
                del self._stops[stop]

    def cancel(self, request_id: str) -> bool:
        """End the work under this id; whether there was any."""
        with self._lock:
            stops = [stop for stop, name in self._stops.items() if name == request_id]
        for stop in stops:
            stop.cancel()
        return bool(stops)

    def close(self) -> None:
        """Refuse new work and end all that is in hand."""
        with self._lock:
            self._closed = True
            for stop in self._stops:
                stop.cancel()
        self._pool.shutdown()


def _ending() -> Unavailable:
    return Unavailable("the planner is shutting down; ask again once it runs")
