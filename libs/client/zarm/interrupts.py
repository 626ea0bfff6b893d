"""How the calls of a client wait, and what may end a wait: Ctrl-C, or the end of the task that called."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import AbstractContextManager, nullcontext
from typing import Protocol, TypeVar

T = TypeVar("T")

SLICE = 0.1
"""s; who waits for something that is told looks so often whether it is interrupted."""


class Interrupts(Protocol):
    """What interrupts a client. An interruption raises KeyboardInterrupt where a call waits."""

    def attend(self, work: Callable[[], T]) -> T:
        """What `work`, which blocks, returns or raises. Once interrupted, nobody hears what becomes of it."""

    def check(self) -> None:
        """Raise KeyboardInterrupt if there was an interruption that has raised none yet."""

    def insist(self, awaited: str) -> AbstractContextManager[None]:
        """A block that is not left at the first interruption; in it `awaited` is waited for."""


class CtrlC:
    """The ordinary one: Python raises KeyboardInterrupt in the main thread, and no other thread is interrupted.

    In the main thread, work is done by a thread of its own, so that KeyboardInterrupt comes up in the wait and not inside a
    library that might swallow it.
    """

    def attend(self, work: Callable[[], T]) -> T:
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
        """Have the thread that waits, or will wait, raise KeyboardInterrupt."""
        self._pending = True
        self._changed.set()

    def attend(self, work: Callable[[], T]) -> T:
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
        """See `Interrupts`: who interrupts does so once."""
        return nullcontext()


def started(work: Callable[[], T], done: Callable[[], object] = lambda: None) -> tuple[Future[T], threading.Thread]:
    """Work that is done by a thread of its own; `done()` is called after it.

    It is no daemon: a thread that is inside Zenoh when the interpreter ends would abort the process.
    """
    future: Future[T] = Future()

    def run() -> None:
        try:
            future.set_result(work())
        except BaseException as error:  # raised again where the result is asked for
            future.set_exception(error)
        done()

    worker = threading.Thread(target=run, name="zarm client")
    worker.start()
    return future, worker
