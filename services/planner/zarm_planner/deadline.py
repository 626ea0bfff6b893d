"""Ends computations early: a deadline, and a cancel from another thread."""

from __future__ import annotations

import math
import threading
import time

import numpy as np

from zarm_contract.errors import Cancelled, DeadlineExceeded

GUARANTEED = 0.02
"""Seconds under a sooner deadline that `give_way` leaves: the default of `optimize_s`."""


class Deadline:
    """A deadline `timeout` s from now that other threads may bring forward.

    `at` (1,) is the moment on the monotonic clock (s), which kernels poll.
    """

    def __init__(self, timeout: float) -> None:
        self._timeout = timeout
        self._sooner: list[Deadline] = []
        self._began = time.monotonic()
        self._lock = threading.Lock()
        self.at = np.array([self._began + timeout])

    def sooner(self, timeout: float) -> Deadline:
        """A deadline `timeout` s from now, but no later than this one; cancelling this one also cancels it."""
        deadline = Deadline(min(timeout, float(self.at[0]) - time.monotonic()))
        self._sooner.append(deadline)
        if self.cancelled:
            deadline.cancel()
        return deadline

    def cancel(self) -> None:
        """End any work under this deadline now."""
        self._bring_forward(-math.inf)
        for deadline in self._sooner:
            deadline.cancel()

    def give_way(self) -> None:
        """End work under sooner deadlines once it has had GUARANTEED s; this deadline itself stays."""
        for deadline in self._sooner:
            deadline._bring_forward(deadline._began + GUARANTEED)

    def _bring_forward(self, moment: float) -> None:
        with self._lock:
            self.at[0] = min(self.at[0], moment)

    @property
    def cancelled(self) -> bool:
        """Whether `cancel` was called."""
        return bool(self.at[0] == -math.inf)

    @property
    def passed(self) -> bool:
        """Whether the deadline has passed or `cancel` was called."""
        return bool(time.monotonic() > self.at[0])

    def check(self) -> None:
        """Raises Cancelled or DeadlineExceeded when it is time to end."""
        if self.cancelled:
            raise Cancelled("the planning was cancelled")
        if self.passed:
            raise DeadlineExceeded(f"no plan within {self._timeout:g} s; allow more time or simplify the scene")
