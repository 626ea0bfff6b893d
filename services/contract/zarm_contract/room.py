"""How many requests are in hand, in all and of each client."""

from __future__ import annotations

import threading
from collections import Counter

from zarm_contract.errors import Busy


class Room:
    """Room for `total` requests on `key`, of which one client may have `share`."""

    def __init__(self, key: str, total: int, share: int) -> None:
        self._key = key
        self._total = total
        self._share = share
        self._held: Counter[str] = Counter()
        self._lock = threading.Lock()

    def enter(self, client: str) -> None:
        """Take a request in. Raises Busy where there is no room for it."""
        with self._lock:
            if self._held.total() >= self._total:
                raise Busy(f"{self._key} has {self._total} requests in hand; try again later")
            if self._held[client] >= self._share:
                raise Busy(
                    f"{self._key} has {self._share} requests of this client in hand, which is the share of one; wait for an "
                    "answer, or cancel one, before you ask for more"
                )
            self._held[client] += 1

    def leave(self, client: str) -> None:
        """Its request is answered."""
        with self._lock:
            self._held[client] -= 1
            if not self._held[client]:
                del self._held[client]
