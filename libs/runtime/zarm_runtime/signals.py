"""SIGTERM and SIGINT, and a wait in the main thread that loses none of them: the self-pipe trick.

The system's own handler writes to a pipe, whatever Python is doing, and the wait looks at that pipe. Python's queues do
not serve for it: in CPython 3.11 `SimpleQueue.get` waits for ever once a handler returns after its deadline, and a signal
that comes just before a thread falls asleep on a lock wakes nobody.
"""

from __future__ import annotations

import math
import os
import select
import signal
from contextlib import suppress

ENDING = (signal.SIGTERM, signal.SIGINT)
"""Those that end a process in order."""

heard: list[int] = []
"""Those that have come since `expect`, by number."""

_LONGEST = 3600.0
"""s, of one look at the pipe; the system's clock of milliseconds overflows after 24 days."""

_reader, _writer = os.pipe()
for _end in (_reader, _writer):
    os.set_blocking(_end, False)
_poll = select.poll()
_poll.register(_reader, select.POLLIN)


def expect() -> None:
    """From now on such a signal does nothing but be heard; the main thread calls this."""
    signal.set_wakeup_fd(_writer, warn_on_full_buffer=False)
    for number in ENDING:
        signal.signal(number, lambda number, _: heard.append(number))


def wake() -> None:
    """End the present wait of the main thread, or its next one; for any thread."""
    with suppress(BlockingIOError):  # full: it wakes anyway
        os.write(_writer, b"\0")


def wait(seconds: float = math.inf) -> None:
    """Wait until a signal is heard or somebody calls `wake`, `seconds` at most; for the main thread alone.

    It may end sooner: look whether what is waited for is there, wait, and look again.
    """
    _poll.poll(1000 * min(max(seconds, 0.0), _LONGEST))
    with suppress(BlockingIOError):
        os.read(_reader, 4096)
