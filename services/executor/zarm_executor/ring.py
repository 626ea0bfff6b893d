"""The last minute of sent and received messages, in memory."""

from __future__ import annotations

import threading
import time
from collections import deque
from dataclasses import dataclass, field

from zarm_contract.keys import Keys
from zarm_runtime.record import Entry
from zarm_runtime.recorded import Recorded

SECONDS = 60
"""How far back (s) the ring reaches."""
SIZE = 64 * 1024 * 1024
"""Its memory limit (bytes), which may shorten its reach."""

_SPAN = 1.0
_SEGMENTS = 64
"""A segment ends after `_SPAN` s, or when it holds this fraction (1/64) of the memory limit; the oldest is dropped
whole.
"""
_OVERHEAD = 270
"""Bytes that Python needs per entry besides its payload: tuple 80, int 32, bytes 33, key up to 90, list slot 9, and
rounding up. Measured with short payloads: 265.
"""


@dataclass
class _Segment:
    began: float
    before: dict[str, Entry]  # values at the start of the segment, for keys that are published only on change
    entries: list[Entry] = field(default_factory=list)
    size: int = 0


class Ring:
    """Keeps what it observes, for at most `seconds` and within `size` bytes. Ages are measured on the monotonic clock.

    Appending costs the same however full the ring is, because segments are dropped whole; so the control loop may do
    it.
    """

    def __init__(self, keys: Keys, seconds: float = SECONDS, size: int = SIZE) -> None:
        self._recorded = Recorded(keys)
        self._seconds = seconds
        self._most = size
        self._size = 0
        self._present: dict[str, Entry] = {}
        self._newest = _Segment(time.monotonic(), {})
        self._segments = deque((self._newest,))
        self._lock = threading.Lock()

    def observe(self, key: str, payload: bytes) -> None:
        """Append a message if its key is recorded; one too large for any reader is left out."""
        published = self._recorded.key(key)
        if published is None or len(payload) > published.model.max_bytes:
            return
        entry, now, size = (time.time_ns(), key, payload), time.monotonic(), len(payload) + _OVERHEAD
        dropped = []  # freed only outside the lock
        with self._lock:
            if now - self._newest.began > _SPAN or self._newest.size + size > self._most // _SEGMENTS:
                self._newest = _Segment(now, self._present.copy())
                self._segments.append(self._newest)
            if published.recorded == "value and changes":
                self._present[key] = entry
            self._newest.entries.append(entry)
            self._newest.size += size
            self._size += size
            while len(self._segments) > 1 and self._outgrown(now):
                dropped.append(self._segments.popleft())
                self._size -= dropped[-1].size

    def contents(self) -> tuple[list[Entry], list[Entry]]:
        """The values that held when the ring begins, and its messages in order of arrival."""
        with self._lock:
            before = list(self._segments[0].before.values())
            *whole, last = (segment.entries for segment in self._segments)
            last = last.copy()
        return before, [entry for entries in (*whole, last) for entry in entries]

    def _outgrown(self, now: float) -> bool:
        return self._size > self._most or self._segments[1].began < now - self._seconds
