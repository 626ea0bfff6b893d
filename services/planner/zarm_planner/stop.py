"""When computing ends early: a deadline, and a cancel from another thread."""

from __future__ import annotations

import math
import threading
import time

import numpy as np

from zarm_contract.errors import Cancelled, DeadlineExceeded

GUARANTEED = 0.02
"""Seconds under a sooner deadline that `give_way` leaves; as long as `optimize_s` is unless a request states it."""


class Stop:
    """A deadline `timeout` s from now that other threads may bring forward; kernels look at it all the time."""

    def __init__(self, timeout: float) -> None:
        self._timeout = timeout
        self._sooner: list[Stop] = []
        self._began = time.monotonic()
        self._lock = threading.Lock()
        self.deadline = np.array([self._began + timeout])

    def sooner(self, timeout: float) -> Stop:
        """A deadline `timeout` s from now and no later than this one's; a cancel of this one is one of that, too."""
        stop = Stop(min(timeout, float(self.deadline[0]) - time.monotonic()))
        self._sooner.append(stop)
        if self.cancelled:
            stop.cancel()
        return stop

    def cancel(self) -> None:
        """End whatever runs under this deadline now."""
        self._bring_forward(-math.inf)
        for stop in self._sooner:
            stop.cancel()

    def give_way(self) -> None:
        """End what runs under sooner deadlines when it has had GUARANTEED s; this one stays."""
        for stop in self._sooner:
            stop._bring_forward(stop._began + GUARANTEED)

    def _bring_forward(self, deadline: float) -> None:
        with self._lock:
            self.deadline[0] = min(self.deadline[0], deadline)

    @property
    def cancelled(self) -> bool:
        """Whether `cancel` was called."""
        return bool(self.deadline[0] == -math.inf)

    @property
    def passed(self) -> bool:
        """Whether the deadline has passed or `cancel` was called."""
        return bool(time.monotonic() > self.deadline[0])

    def check(self) -> None:
        """Raises Cancelled or DeadlineExceeded when it is time to end."""
        if self.cancelled:
            raise Cancelled("the planning was cancelled")
        if self.passed:
            raise DeadlineExceeded(f"no plan within {self._timeout:g} s; allow more time or simplify the scene")
