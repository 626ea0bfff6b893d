"""A function called at a fixed rate in its own thread."""

from __future__ import annotations

import logging
import os
import threading
from bisect import bisect_left
from collections.abc import Callable
from types import TracebackType
from typing import Self

from zarm_runtime import clock
from zarm_runtime.realtime import CONTROL_PRIORITY, ask_for_realtime

log = logging.getLogger(__name__)

LATE = (0.00005, 0.0001, 0.0002, 0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1)
"""Bucket bounds (s) of the lateness of calls: usually 0.05 ms, 0.3 ms beside a busy planner."""


class Loop:
    """Calls `work(now)` every `period` s from `start` to `stop`, or inside a `with`.

    Deadlines lie on a fixed grid of the monotonic clock, so they neither drift nor bunch up; `now` is the deadline.
    Missed deadlines are skipped: the next call then comes two or more periods later.

    A `realtime` loop takes precedence over every other thread of the machine, if the system permits.

    An exception ends the whole process at once with code 1: with a thread lost nobody controls the robot, and the
    supervisor restarts the process at rest.
    """

    def __init__(self, name: str, period: float, work: Callable[[float], object], *, realtime: bool = False) -> None:
        self._name = name
        self._period = period
        self._work = work
        self._realtime = realtime
        self._ended = threading.Event()
        self._thread = threading.Thread()
        self._late_counts = [0] * (len(LATE) + 1)
        self._late_sum = self._latest = 0.0
        self.ticks = 0
        """Number of completed calls."""

    def lateness(self) -> tuple[list[int], float]:
        """The number of calls by lateness, one per interval of `LATE`, and the total lateness (s)."""
        return self._late_counts.copy(), self._late_sum

    def latest(self) -> float:
        """The greatest lateness (s) of a call since this was last asked."""
        latest, self._latest = self._latest, 0.0
        return latest

    def start(self) -> None:
        """Begin; the first call comes at once. A stopped loop may be started again."""
        self._ended.clear()
        self._thread = threading.Thread(target=self._run, name=self._name, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End, after the current call, if any."""
        self._ended.set()
        self._thread.join()

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def _run(self) -> None:
        try:
            if self._realtime and not ask_for_realtime(CONTROL_PRIORITY):
                log.info("no real-time priority loop=%s remedy=allow_CAP_SYS_NICE_or_RLIMIT_RTPRIO", self._name)
            deadline = clock.monotonic()
            while not self._ended.is_set():
                clock.sleep(max(0.0, deadline - clock.monotonic()))
                late = max(0.0, clock.monotonic() - deadline)
                self._late_counts[bisect_left(LATE, late)] += 1
                self._late_sum += late
                self._latest = max(self._latest, late)
                deadline += self._period * (late // self._period)
                self._work(deadline)
                self.ticks += 1
                deadline += self._period
        except Exception:
            log.critical("the loop %s failed; the process ends", self._name, exc_info=True)
            os._exit(1)
