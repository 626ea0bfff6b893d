"""The executor whose control loop hangs once the file $HANG exists: `python hanging_executor.py ...`."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import zarm_executor.service
from zarm_executor.machine import Machine
from zarm_executor.strategies.base import Measured

tick = Machine.tick


def hang(machine: Machine, now: float) -> Measured | None:
    """Acts like an endless loop under the machine's lock."""
    with machine._lock:
        while Path(os.environ["HANG"]).exists():
            pass
    return tick(machine, now)


if __name__ == "__main__":
    Machine.tick = hang  # type: ignore[method-assign]
    sys.exit(zarm_executor.service.main())
