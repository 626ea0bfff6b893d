"""How the calls of a client wait, and what may end a wait: Ctrl-C, or the cancellation of the calling task."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import AbstractContextManager, nullcontext
from typing import Protocol, TypeVar

T = TypeVar("T")

SLICE = 0.1
"""Interval (s) at which a wait checks for interruptions."""


class Interrupts(Protocol):
    """The source of a client's interruptions, which raise KeyboardInterrupt where a call waits."""

    def run_interruptibly(self, work: Callable[[], T]) -> T:
        """The result or exception of `work`, which blocks. After an interruption its result is lost."""

    def check(self) -> None:
        """Raise KeyboardInterrupt for a pending interruption."""

    def insist(self, awaited: str) -> AbstractContextManager[None]:
        """A block that the first interruption does not leave, while it waits for `awaited`."""


class CtrlC:
    """The usual source: Python raises KeyboardInterrupt in the main thread, and no other thread is interrupted.

    In the main thread, work is done by a separate thread, so that KeyboardInterrupt occurs in the wait and not inside a
    library that might swallow it.
    """

    def run_interruptibly(self, work: Callable[[], T]) -> T:
        """See `Interrupts`."""
        if threading.current_thread() is not threading.main_thread():
            return work()
        future, worker = started(work)
        while worker.is_alive():
            worker.join(SLICE)
        return future.result()

    def check(self) -> None:
        """See `Interrupts`: Python does it."""

    def insist(self, awaited: str) -> AbstractContextManager[None]:
        """See `Interrupts`: the next Ctrl-C leaves the block."""
        return nullcontext()


class Interruption:
    """An interruption by another thread, `interrupt`; it is raised once."""

    def __init__(self) -> None:
        self._changed = threading.Event()
        self._pending = False

    def interrupt(self) -> None:
        """Make the thread that waits, or will wait, raise KeyboardInterrupt."""
        self._pending = True
        self._changed.set()

    def run_interruptibly(self, work: Callable[[], T]) -> T:
        """See `Interrupts`."""
        future, _ = started(work, self._changed.set)
        while not future.done():
            self._changed.wait()
            self._changed.clear()
            self.check()
        return future.result()

    def check(self) -> None:
        """See `Interrupts`."""
        if self._pending:
            self._pending = False
            raise KeyboardInterrupt

    def insist(self, awaited: str) -> AbstractContextManager[None]:
        """See `Interrupts`: there is only one interruption."""
        return nullcontext()


def started(work: Callable[[], T], done: Callable[[], object] = lambda: None) -> tuple[Future[T], threading.Thread]:
    """Work done by a separate thread; `done()` is called after it.

    The thread is not a daemon: one inside Zenoh when the interpreter ends would abort the process.
    """
    future: Future[T] = Future()

    def run() -> None:
        try:
            future.set_result(work())
        except BaseException as error:  # raised again where the result is requested
            future.set_exception(error)
        done()

    worker = threading.Thread(target=run, name="zarm client")
    worker.start()
    return future, worker
