"""The order in which commands arrive on several keys, so that a stop overrides everything that came before it."""

from __future__ import annotations

import itertools
import logging
import threading
import time
from collections.abc import Callable
from typing import Any

log = logging.getLogger(__name__)

PERIOD, UNHURRIED = 0.002, 0.01
"""Polling intervals (s): the second if messages need not be noticed at once. A poll takes 60 us of CPU, most of it to
wake up: 3 % of a core with the first, 0.6 % with the second.
"""

MESSAGES_PER_POLL = 1024
"""Most messages of one key taken in one poll."""


class Arrivals:
    """Takes the messages on several keys off their channels, numbers them, and hands them on; it has its own thread.

    Zenoh fills the channels without Python, so a busy interpreter does not hold up the network. In each poll the keys
    that overtake others are read first and get the larger numbers: a message on another key that came before a stop is
    found in the same poll at the latest, and numbered before it. `urgent` selects the polling interval.
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
        """From now on call `take(message, number)` for each message of a subscriber or queryable; it must return at
        once.
        """
        keys = self._overtaken if overtaken else self._overtaking
        keys.append((entity, take))

    def close(self) -> None:
        """Stop taking messages."""
        self._closed = True
        self._thread.join()

    def _run(self) -> None:
        while not self._closed:
            time.sleep(PERIOD if self._urgent() else UNHURRIED)
            last = self._drained(self._overtaking)
            for message, take in (*self._drained(self._overtaken), *last):
                try:
                    take(message, next(self._numbers))
                except Exception:  # whatever goes wrong with one message, the next must be taken
                    log.exception("a message could not be handled")

    @staticmethod
    def _drained(keys: list[tuple[Any, Callable[[Any, int], None]]]) -> list[tuple[Any, Callable[[Any, int], None]]]:
        found = []
        for entity, take in list(keys):
            for _ in range(MESSAGES_PER_POLL):
                if (message := entity.try_recv()) is None:
                    break
                found.append((message, take))
        return found
