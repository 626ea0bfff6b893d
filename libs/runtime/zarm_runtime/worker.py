"""A thread that works when it is woken, and from time to time."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from types import TracebackType
from typing import Self

from zarm_runtime import clock

log = logging.getLogger(__name__)


class Worker:
    """Calls `work` in a thread of its own from `start` to `stop`, or inside a `with`: once it is woken, and at the latest `period` s after the
    last call, if given.

    `work` may return another time (s) for this once. Several wakes during a call, or before `start`, are one. An
    exception is logged, and the next call comes as if there had been none.
    """

    def __init__(self, name: str, work: Callable[[], float | None], period: float | None = None) -> None:
        self._name, self._work, self._period = name, work, period
        self._woken, self._ended = threading.Event(), False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def wake(self) -> None:
        """Call `work` now, or again once the present call has returned."""
        self._woken.set()

    def start(self) -> None:
        """Begin. A worker that was stopped cannot be started again."""
        self._thread.start()

    def stop(self) -> None:
        """End, after the present call. Idempotent, also before `start`."""
        self._ended = True
        self._woken.set()
        if self._thread.ident is not None:
            self._thread.join()

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def _run(self) -> None:
        wait = self._period
        while True:
            self._woken.wait(None if wait is None else clock.real_seconds(wait))
            if self._ended:
                return
            self._woken.clear()
            try:
                wait = self._work()
            except Exception:  # whatever goes wrong once, the next call must come
                log.exception("work failed thread=%s", self._name)
                wait = None
            wait = self._period if wait is None else wait
