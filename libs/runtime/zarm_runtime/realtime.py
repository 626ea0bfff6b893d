"""Real-time priority, if the system allows it, for everything that a moving robot waits for."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

PROCESS_PRIORITY = 10
CONTROL_PRIORITY = 20
"""Above every ordinary thread, below the kernel's own (50)."""


def ask_for_realtime(priority: int) -> bool:
    """Give the calling thread, and all threads it starts from now on, a real-time priority; returns whether that is
    allowed.
    """
    try:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(priority))
    except (AttributeError, PermissionError):  # no such call on macOS; no such right in most containers
        return False
    return True


@contextmanager
def realtime_offspring(priority: int) -> Iterator[None]:
    """Threads started inside by the calling one have a real-time priority, if allowed; that of the caller is restored."""
    allowed = ask_for_realtime(priority)
    try:
        yield
    finally:
        if allowed:
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
