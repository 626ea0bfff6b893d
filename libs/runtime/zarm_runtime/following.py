"""The values of a latched key, delivered to one subscriber."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

import zenoh

from zarm_contract.access import reading
from zarm_runtime.publications import Observer, understood

log = logging.getLogger(__name__)


class Following:
    """Calls `callback(key, payload)` with publications on `key` and with values read, such that the last call has the
    newest.

    `timeout` (s) is the longest wait for an answer.
    """

    def __init__(
        self,
        session: zenoh.Session,
        key: str,
        callback: Callable[[str, bytes], None],
        observe: Observer,
        timeout: float,
    ) -> None:
        self._session = session
        self._key = key
        self._callback = callback
        self._observe = observe
        self._timeout = timeout
        self._turn = threading.Lock()
        self._reading = threading.Lock()
        self._published: set[str] | None = None  # since the read began

    def receive(self, name: str, payload: bytes) -> None:
        """Take a publication."""
        with self._turn:
            if self._published is not None:
                self._published.add(name)
            self._callback(name, payload)

    def read(self) -> bool:
        """Read the present values; returns whether anyone answered."""
        answered = False
        with self._reading:
            with self._turn:
                self._published = set()
            try:
                for reply in self._session.get(reading(self._key), timeout=self._timeout):
                    if reply.ok is not None and understood(reply.ok):
                        answered = True
                        self._read(str(reply.ok.key_expr), reply.ok.payload.to_bytes())
            except zenoh.ZError as error:  # the link is lost again, or the session closed
                log.info("not read key=%s reason=%s", self._key, error)
            finally:
                with self._turn:
                    self._published = None
        return answered

    def _read(self, name: str, payload: bytes) -> None:
        with self._turn:
            if self._published is None or name not in self._published:  # else this answer may be the older one
                self._observe(name, payload)
                self._callback(name, payload)
