"""The work in hand: how much of it runs at once, and how it is ended before its time."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TypeVar

from zarm_contract.errors import Cancelled, Unavailable
from zarm_planner.stop import Stop

T = TypeVar("T")

_POLL = 0.02
"""Seconds between looks at the stop of work that waits for its turn."""


class Running:
    """Runs as much work at a time as there are `slots`, each in the thread that asks for it.

    What waits for its turn has its deadline and can be cancelled.
    """

    def __init__(self, slots: int) -> None:
        self._slots = threading.Semaphore(slots)
        self._changed = threading.Condition()
        self._stops: dict[Stop, str | None] = {}
        self._closed = False

    def run(self, work: Callable[[Stop], T], timeout: float, request_id: str | None = None) -> T:
        """The result of `work(stop)`, which must look at its stop. Raises Unavailable once the service ends."""
        stop = Stop(timeout)
        with self._changed:
            if self._closed:
                raise _ending()
            self._stops[stop] = request_id
        try:
            while not self._slots.acquire(timeout=_POLL):
                stop.check()
            try:
                stop.check()
                return work(stop)
            finally:
                self._slots.release()
        except Cancelled as error:
            if self._closed:
                raise _ending() from error
            raise
        finally:
            with self._changed:
                del self._stops[stop]
                self._changed.notify_all()

    def cancel(self, request_id: str) -> bool:
        """End the work under this id; whether there was any."""
        with self._changed:
            stops = [stop for stop, name in self._stops.items() if name == request_id]
        for stop in stops:
            stop.cancel()
        return bool(stops)

    def close(self) -> None:
        """Refuse new work, end all that is in hand, and wait until it has ended."""
        with self._changed:
            self._closed = True
            for stop in self._stops:
                stop.cancel()
            self._changed.wait_for(lambda: not self._stops)


def _ending() -> Unavailable:
    return Unavailable("the planner is shutting down; ask again once it runs")
