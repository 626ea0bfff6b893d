"""The order in which commands arrive on several keys, so that a stop wins over all that came before it."""

from __future__ import annotations

import itertools
import logging
import threading
import time
from collections.abc import Callable
from typing import Any

log = logging.getLogger(__name__)

PERIOD, UNHURRIED = 0.002, 0.01
"""How often (s) it is looked whether something has come, and how often where that need not be known at once. A look takes 60 us of
CPU, most of it to wake up: 3 % of a core at the first, 0.6 % at the second."""

MOST = 1024
"""So many messages of one key are taken in one look."""


class Arrivals:
    """Takes what has come on several keys off their channels, numbers it, and hands it on; it has a thread of its own.

    Zenoh fills the channels without Python, so that nothing that keeps the interpreter busy holds up the network. In each look
    the keys that overtake others come first and get the larger numbers: what came on another key before a stop is found in the same
    look at the latest, and numbered before it. `urgent` says how often to look.
    """

    def __init__(self, urgent: Callable[[], bool]) -> None:
        self._urgent = urgent
        self._overtaking: list[tuple[Any, Callable[[Any, int], None]]] = []
        self._overtaken: list[tuple[Any, Callable[[Any, int], None]]] = []
        self._numbers = itertools.count(1)
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="arrivals", daemon=True)
        self._thread.start()

    def add(self, entity: Any, take: Callable[[Any, int], None], *, overtaken: bool) -> None:
        """From now on `take(message, number)` is called for each message of a subscriber or queryable; it must return at once."""
        keys = self._overtaken if overtaken else self._overtaking
        keys.append((entity, take))

    def close(self) -> None:
        """Take nothing any more."""
        self._closed = True
        self._thread.join()

    def _run(self) -> None:
        while not self._closed:
            time.sleep(PERIOD if self._urgent() else UNHURRIED)
            last = self._drained(self._overtaking)
            for message, take in (*self._drained(self._overtaken), *last):
                try:
                    take(message, next(self._numbers))
                except Exception:  # whatever goes wrong with one, the next is to be taken
                    log.exception("a message could not be handled")

    @staticmethod
    def _drained(keys: list[tuple[Any, Callable[[Any, int], None]]]) -> list[tuple[Any, Callable[[Any, int], None]]]:
        found = []
        for entity, take in list(keys):
            for _ in range(MOST):
                if (message := entity.try_recv()) is None:
                    break
                found.append((message, take))
        return found
