"""Limits on pending requests, in total and per client."""

from __future__ import annotations

import threading
from collections import Counter

from zarm_contract.errors import Busy


class Quota:
    """Room for `total` requests on `key`. If it is `shared`, no client has more pending than remain for others.

    So one client alone gets half of it, the next half of the rest, and latecomers find some room; if two are greedy for
    long, each has a third.
    """

    def __init__(self, key: str, total: int, *, shared: bool) -> None:
        self._key = key
        self._total = total
        self._shared = shared
        self._held: Counter[str] = Counter()
        self._lock = threading.Lock()

    def enter(self, client: str) -> None:
        """Admit a request. Raises Busy if there is no room for it."""
        with self._lock:
            left, held = self._total - self._held.total(), self._held[client]
            if not left:
                raise Busy(f"{self._key} has {self._total} pending requests; try again later")
            if self._shared and held >= left:
                raise Busy(
                    f"{self._key} has {held} pending requests of this client, and the {left} free places are for others; wait "
                    "for an answer, or cancel one, before you send more"
                )
            self._held[client] += 1

    def leave(self, client: str) -> None:
        """A request has been answered."""
        with self._lock:
            self._held[client] -= 1
            if not self._held[client]:
                del self._held[client]
