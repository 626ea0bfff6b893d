"""Published values one after the other, for a loop that takes the newest."""

from __future__ import annotations

import threading
from collections.abc import Callable, Generator
from typing import Generic, TypeVar

from zarm.interrupts import SLICE, Interrupts
from zarm_contract.messages import Message

M = TypeVar("M", bound=Message | bytes)


class Newest(Generic[M]):
    """The newest value that one thread puts and another takes; values not taken in time are skipped."""

    def __init__(self) -> None:
        self._value: M | None = None
        self._changed = threading.Condition()

    def put(self, value: M) -> None:
        """Replace the value."""
        with self._changed:
            self._value = value
            self._changed.notify_all()

    def take(self, seconds: float) -> M | None:
        """The value, if there is an untaken one within `seconds`."""
        with self._changed:
            self._changed.wait_for(lambda: self._value is not None, seconds)
            value, self._value = self._value, None
            return value


def live(
    subscribe: Callable[[Callable[[M], None]], Callable[[], None]], interrupts: Interrupts, check: Callable[[], None]
) -> Generator[M]:
    """Each value passed to the callback subscribed here; a slower loop gets the newest. Its end ends the subscription.

    `check` is called ten times a second and more, and may raise.
    """
    newest: Newest[M] = Newest()
    end = subscribe(newest.put)
    try:
        while True:
            interrupts.check()
            check()
            if (value := newest.take(SLICE)) is not None:
                yield value
    finally:
        end()
