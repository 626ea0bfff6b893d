"""When computing ends early: a deadline, and a cancel from another thread."""

from __future__ import annotations

import math
import time

import numpy as np

from zarm_contract.errors import Cancelled, DeadlineExceeded


class Stop:
    """A deadline `timeout` s from now that other threads may bring forward; kernels look at it all the time."""

    def __init__(self, timeout: float) -> None:
        self._timeout = timeout
        self._sooner: list[Stop] = []
        self.deadline = np.array([time.monotonic() + timeout])

    def sooner(self, timeout: float) -> Stop:
        """A deadline `timeout` s from now and no later than this one's; a cancel of this one is one of that, too."""
        stop = Stop(min(timeout, float(self.deadline[0]) - time.monotonic()))
        self._sooner.append(stop)
        if self.cancelled:
            stop.cancel()
        return stop

    def cancel(self) -> None:
        """End whatever runs under this deadline now."""
        self.deadline[0] = -math.inf
        for stop in self._sooner:
            stop.cancel()

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
