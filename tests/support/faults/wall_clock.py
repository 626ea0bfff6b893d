"""The wall clock of single processes, which a test can step."""

from __future__ import annotations

import os
import platform
import sys
from pathlib import Path

from support.paths import PROGRAMS

STEPPABLE = sys.platform == "linux" and platform.machine() == "x86_64"
"""Whether `stepped_clock` has the code for this machine."""

_FOLDER = PROGRAMS / "stepped_clock"


class WallClock:
    """The clock of every process started with `environment`; right until it is stepped."""

    def __init__(self, file: Path) -> None:
        self._file = file
        file.write_bytes(bytes(8))
        path = os.pathsep.join(filter(None, (str(_FOLDER), os.environ.get("PYTHONPATH"))))
        self.environment = {"ZARM_TEST_CLOCK": str(file), "PYTHONPATH": path}

    def step(self, seconds: int) -> None:
        """Set it this much ahead of the true time."""
        with self._file.open("r+b") as file:
            file.write(seconds.to_bytes(8, sys.byteorder, signed=True))
