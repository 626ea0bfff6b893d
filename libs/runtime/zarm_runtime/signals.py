"""SIGTERM and SIGINT, and a wait in the main thread that loses none of them: the self-pipe trick.

The system's own handler writes to a pipe, whatever Python is doing, and the wait polls that pipe. Python's queues are
unsuitable: in CPython 3.11 `SimpleQueue.get` waits for ever if a handler returns after its deadline, and a signal just
before a thread falls asleep on a lock wakes nobody.
"""

from __future__ import annotations

import math
import os
import select
import signal
from contextlib import suppress

ENDING = (signal.SIGTERM, signal.SIGINT)
"""Signals that end a process in order."""

received: list[int] = []
"""Signals that have come since `expect`, by number."""

_POLL_TIMEOUT = 3600.0
"""s, of one poll of the pipe; the system's millisecond clock overflows after 24 days."""

_reader, _writer = os.pipe()
for _end in (_reader, _writer):
    os.set_blocking(_end, False)
_poll = select.poll()
_poll.register(_reader, select.POLLIN)


def expect() -> None:
    """From now on such a signal is only recorded; called by the main thread."""
    signal.set_wakeup_fd(_writer, warn_on_full_buffer=False)
    for number in ENDING:
        signal.signal(number, lambda number, _: received.append(number))


def wake() -> None:
    """End the present or next wait of the main thread; may be called from any thread."""
    with suppress(BlockingIOError):  # full: it wakes anyway
        os.write(_writer, b"\0")


def wait(seconds: float = math.inf) -> None:
    """Wait until a signal comes or `wake` is called, at most `seconds`; only for the main thread.

    It may end early: check the awaited condition, wait, and check again.
    """
    _poll.poll(1000 * min(max(seconds, 0.0), _POLL_TIMEOUT))
    with suppress(BlockingIOError):
        os.read(_reader, 4096)
