"""Ends the process if the control loop no longer ticks."""

from __future__ import annotations

import faulthandler
import logging
import os
import threading
from types import TracebackType
from typing import Self

from zarm_executor.loop import Loop
from zarm_runtime.realtime import CONTROL_PRIORITY, ask_for_realtime

log = logging.getLogger(__name__)

UNHEALTHY = 0.5
"""A control loop that has not ticked for this long (s) makes the service unhealthy."""
LIMIT = 2.0
"""A control loop that has not ticked for this long (s) ends the process."""
_PERIOD = 0.25


class Watchdog:
    """Ends the process with code 1 once `loop` has not ticked for `LIMIT` s, and logs what each thread was doing; use
    it in `with`.

    The supervisor restarts the process at rest; meanwhile the robot's driver runs out of points. Time during which the
    whole process was suspended (SIGSTOP, a sleeping machine) does not count: the loop then continues by itself.
    """

    def __init__(self, loop: Loop) -> None:
        self._loop = loop
        self._missed = 0
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="watchdog", daemon=True)

    def impairment(self) -> str | None:
        """What is wrong with the control loop, as in `Service.impairment`."""
        silent = self._missed * _PERIOD
        return f"the control loop has not ticked for {silent:.1f} s" if silent >= UNHEALTHY else None

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended.set()
        self._thread.join()

    def _run(self) -> None:
        ask_for_realtime(CONTROL_PRIORITY)  # a loop that spins must not keep the watchdog from running
        seen = self._loop.ticks
        while not self._ended.wait(_PERIOD):
            ticks = self._loop.ticks
            self._missed = self._missed + 1 if ticks == seen else 0
            seen = ticks
            if self._missed * _PERIOD >= LIMIT:
                log.critical("the control loop does not tick; the process ends seconds=%.1f", LIMIT)
                faulthandler.dump_traceback(all_threads=True)
                os._exit(1)
