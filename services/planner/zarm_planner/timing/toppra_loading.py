"""Loads TOPPRA when a plan first needs it: beside the planning, since it takes a second and plans have deadlines."""

from __future__ import annotations

import threading
from functools import cache
from importlib import import_module

from zarm_planner.deadline import Deadline

_MODULE = "zarm_planner.timing.toppra_without_plots"
_POLL = 0.01
"""Seconds between looks at the deadline."""


@cache
def load_toppra() -> threading.Thread:
    """The thread that loads it, which begins with the first call."""
    thread = threading.Thread(target=import_module, args=(_MODULE,), name="load TOPPRA", daemon=True)
    thread.start()
    return thread


def await_toppra(deadline: Deadline) -> None:
    """Return when it is loaded. Raises what the deadline raises."""
    loading = load_toppra()
    while loading.is_alive():
        deadline.check()
        loading.join(_POLL)
