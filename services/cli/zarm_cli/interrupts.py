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


_LOOK_SECONDS = 0.05
"""How long a signal that comes while a command waits may go unnoticed. Nothing that a handler may do wakes a thread for
certain: the signal may come just before it falls asleep."""


class _Signals:
    """`heard` as soon as there was one, `pending` until KeyboardInterrupt is raised for it."""

    def __init__(self) -> None:
        self.heard = False
        self.pending = False

    def hear(self, number: int, frame: FrameType | None) -> None:
        """The handler."""
        if not self.heard:
            self.heard = self.pending = True


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


def wait_for(source: SimpleQueue[T], seconds: float = math.inf) -> T:
    """The next thing in a queue. Raises queue.Empty when there is none for so many s, and KeyboardInterrupt."""
    deadline = time.monotonic() + seconds
    while True:
        check()
        left = deadline - time.monotonic()
        try:
            return source.get(timeout=max(0.0, min(left, _LOOK_SECONDS)))
        except Empty:
            if left <= _LOOK_SECONDS:
                raise


def pause(seconds: float = math.inf) -> None:
    """Wait. Raises KeyboardInterrupt."""
    with suppress(Empty):
        wait_for(SimpleQueue[None](), seconds)


def attend(work: Callable[[], T]) -> T:
    """What `work` returns or raises, done by another thread. Raises KeyboardInterrupt, and then nobody hears what became of it."""
    done: SimpleQueue[Future[T]] = SimpleQueue()
    _work.submit(work).add_done_callback(done.put)
    return wait_for(done).result()
