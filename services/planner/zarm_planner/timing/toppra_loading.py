"""Loads TOPPRA when a plan first needs it, in parallel to the planning, since it takes a second and plans have
deadlines.
"""

from __future__ import annotations

import threading
from functools import cache
from importlib import import_module

from zarm_planner.deadline import Deadline

_MODULE = "zarm_planner.timing.toppra_without_plots"
_POLL = 0.01
"""Interval (s) at which the deadline is checked."""


@cache
def load_toppra() -> threading.Thread:
    """The thread that loads TOPPRA, started by the first call."""
    thread = threading.Thread(target=import_module, args=(_MODULE,), name="load TOPPRA", daemon=True)
    thread.start()
    return thread


def await_toppra(deadline: Deadline) -> None:
    """Return when TOPPRA is loaded. Raises the deadline's error."""
    loading = load_toppra()
    while loading.is_alive():
        deadline.check()
        loading.join(_POLL)
