"""Ctrl-C and SIGTERM: the first one raises KeyboardInterrupt where a command waits, and only there.

Raised by the handler itself, as by default in Python, KeyboardInterrupt may occur between any two lines: on entering
the `__exit__` that stops the services, which then keep running, or inside a library that swallows it (pydantic's
serializer, wherever it checks a type), and the robot moves on.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Generic, TypeVar

from zarm_runtime import signals

T = TypeVar("T")

_INSISTS = 1.0
"""Least time (s) that a command insists, so that its request is sent and a responding robot is waited for."""


class Inbox(Generic[T]):
    """Items from other threads for the main thread, which takes them with `wait_for`."""

    def __init__(self) -> None:
        self._things: deque[T] = deque()

    def put(self, thing: T) -> None:
        """Add an item; may be called from any thread."""
        self._things.append(thing)
        signals.wake()

    def take(self) -> T | None:
        """The oldest item, or None."""
        return self._things.popleft() if self._things else None


class _Insistence:
    def __init__(self, explain: Callable[[], object]) -> None:
        self._explain = explain
        self._explained = False
        self._until = time.monotonic() + _INSISTS

    def check(self) -> None:
        if len(signals.received) == 2 and not self._explained:
            self._explained = True
            self._explain()
        if len(signals.received) > 2 and time.monotonic() >= self._until:
            raise KeyboardInterrupt

    def seconds(self) -> float:
        """Seconds for which a third signal is still ignored; infinite once it counts."""
        left = self._until - time.monotonic()
        return left if left > 0 else math.inf


class _State:
    raised = False
    """Whether the first signal has raised KeyboardInterrupt."""
    insistence: _Insistence | None = None


_state = _State()
_work = ThreadPoolExecutor(2, thread_name_prefix="attended")


def pending() -> bool:
    """Whether a signal came and nothing has raised KeyboardInterrupt yet."""
    return bool(signals.received) and not _state.raised


def check() -> None:
    """Raise KeyboardInterrupt if a signal is pending."""
    if _state.insistence is not None:
        _state.insistence.check()
    elif pending():
        _state.raised = True
        raise KeyboardInterrupt


@contextmanager
def insist(explain: Callable[[], object]) -> Iterator[None]:
    """A block in which a first signal stays pending, a second one makes `explain` show what is awaited, and a third one,
    though not in the first second, raises KeyboardInterrupt.
    """
    _state.insistence = _Insistence(explain)
    try:
        yield
    finally:
        _state.insistence = None


def wait_for(inbox: Inbox[T], seconds: float = math.inf) -> T | None:
    """The next item of an inbox, None if none comes for `seconds`. Raises KeyboardInterrupt."""
    deadline = time.monotonic() + seconds
    while True:
        check()
        if (thing := inbox.take()) is not None:
            return thing
        if (left := deadline - time.monotonic()) <= 0:
            return None
        signals.wait(left if _state.insistence is None else min(left, _state.insistence.seconds()))


def pause(seconds: float = math.inf) -> None:
    """Wait. Raises KeyboardInterrupt."""
    wait_for(Inbox[None](), seconds)


def run_interruptibly(work: Callable[[], T]) -> T:
    """The result or exception of `work`, run by another thread. On KeyboardInterrupt its result is lost."""
    done: Inbox[bool] = Inbox()
    future = _work.submit(work)
    future.add_done_callback(lambda _: done.put(True))
    wait_for(done)
    return future.result()
