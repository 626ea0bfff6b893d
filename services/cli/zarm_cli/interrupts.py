"""Ctrl-C and SIGTERM: the first of them raises KeyboardInterrupt where a command waits, and nowhere else.

Raised by the handler itself, as Python does it, KeyboardInterrupt comes up between any two lines: at the door of the
`__exit__` that stops the services, which are then left, or within a library that swallows it (pydantic's serializer, wherever
it asks what something is an instance of), and the robot moves on.
"""

from __future__ import annotations

import math
import signal
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from queue import Empty, SimpleQueue
from types import FrameType
from typing import TypeVar

T = TypeVar("T")


class _Signals:
    """`waiting` is the queue at which the command waits now; None in it wakes the command."""

    def __init__(self) -> None:
        self.heard = False
        self.pending = False
        self.waiting: SimpleQueue[None] | None = None

    def hear(self, number: int, frame: FrameType | None) -> None:
        """The handler."""
        if not self.heard:
            self.heard = self.pending = True
            if self.waiting is not None:
                self.waiting.put(None)  # of all ways to wake a thread the one that a handler may take (it is reentrant)


_signals = _Signals()
_work = ThreadPoolExecutor(2, thread_name_prefix="attended")


def expect() -> None:
    """From now on the signals are heard here."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _signals.hear)


def pending() -> bool:
    """Whether a signal came for which nothing has raised KeyboardInterrupt yet."""
    return _signals.pending


def check() -> None:
    """Raise KeyboardInterrupt if a signal is pending."""
    if _signals.pending:
        _signals.pending = False
        raise KeyboardInterrupt


def wait_for(source: SimpleQueue[T | None], seconds: float = math.inf) -> T:
    """The next thing in a queue. Raises queue.Empty when there is none for so many s, and KeyboardInterrupt."""
    deadline = time.monotonic() + seconds
    _signals.waiting = source  # type: ignore[assignment]
    try:
        while True:
            check()
            left = None if seconds == math.inf else max(0.0, deadline - time.monotonic())
            if (item := source.get(timeout=left)) is not None:
                return item
    finally:
        _signals.waiting = None


def pause(seconds: float = math.inf) -> None:
    """Wait. Raises KeyboardInterrupt."""
    with suppress(Empty):
        wait_for(SimpleQueue[None](), seconds)


def attend(work: Callable[[], T]) -> T:
    """What `work` returns or raises, done by another thread. Raises KeyboardInterrupt, and then nobody hears what became of it."""
    done: SimpleQueue[Future[T] | None] = SimpleQueue()
    _work.submit(work).add_done_callback(done.put)
    return wait_for(done).result()
