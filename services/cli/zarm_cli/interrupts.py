"""Ctrl-C and SIGTERM: the first one raises KeyboardInterrupt where a command waits, and only there.

Raised by the handler itself, as Python does it, KeyboardInterrupt comes up between any two lines: at the door of the
`__exit__` that stops the services, which are then left, or within a library that swallows it (pydantic's serializer, wherever
it asks what something is an instance of), and the robot moves on.
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
"""Seconds that a command insists at least: what it asks for gets on its way, and a robot that answers is waited for."""


class Inbox(Generic[T]):
    """What other threads have for the main one, which takes it with `wait_for`."""

    def __init__(self) -> None:
        self._things: deque[T] = deque()

    def put(self, thing: T) -> None:
        """Add something; for any thread."""
        self._things.append(thing)
        signals.wake()

    def take(self) -> T | None:
        """The oldest thing, or None."""
        return self._things.popleft() if self._things else None


class _Insistence:
    def __init__(self, tell: Callable[[], object]) -> None:
        self._tell = tell
        self._told = False
        self._until = time.monotonic() + _INSISTS

    def check(self) -> None:
        if len(signals.heard) == 2 and not self._told:
            self._told = True
            self._tell()
        if len(signals.heard) > 2 and time.monotonic() >= self._until:
            raise KeyboardInterrupt

    def seconds(self) -> float:
        """How long a third signal still counts for nothing; without end where it counts."""
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
    return bool(signals.heard) and not _state.raised


def check() -> None:
    """Raise KeyboardInterrupt if a signal is pending."""
    if _state.insistence is not None:
        _state.insistence.check()
    elif pending():
        _state.raised = True
        raise KeyboardInterrupt


@contextmanager
def insist(tell: Callable[[], object]) -> Iterator[None]:
    """In this block a first signal stays pending, a second one has `tell` say what is waited for, and a third one, though not
    in the first second, raises KeyboardInterrupt.
    """
    _state.insistence = _Insistence(tell)
    try:
        yield
    finally:
        _state.insistence = None


def wait_for(inbox: Inbox[T], seconds: float = math.inf) -> T | None:
    """The next thing in an inbox, None when there is none for so many s. Raises KeyboardInterrupt."""
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


def attend(work: Callable[[], T]) -> T:
    """What `work` returns or raises, done by another thread. Raises KeyboardInterrupt, and then nobody hears what became of it."""
    done: Inbox[bool] = Inbox()
    future = _work.submit(work)
    future.add_done_callback(lambda _: done.put(True))
    wait_for(done)
    return future.result()
