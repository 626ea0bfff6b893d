"""Logs: one line per event on standard error, `service | HH:MM:SS level=... event key=value`, coloured on request."""

from __future__ import annotations

import logging
import os
import sys
import time

_COLOURS = {"planner": 36, "executor": 33, "ros_bridge": 35}


BURST = 20
BURST_PERIOD = 10.0
"""How many warnings of one kind are logged in this many seconds: whoever sends nonsense does not fill the disk."""


class Flood(logging.Filter):
    """Passes the first `BURST` warnings or errors that one line of code logs in `BURST_PERIOD` s; the last says so."""

    def __init__(self) -> None:
        super().__init__()
        self._passed: dict[tuple[str, int], tuple[float, int]] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether the record is logged."""
        if record.levelno < logging.WARNING:
            return True
        place, now = (record.pathname, record.lineno), time.monotonic()
        since, passed = self._passed.get(place, (now, 0))
        if now - since > BURST_PERIOD:
            since, passed = now, 0
        self._passed[place] = since, passed + 1
        if passed == BURST - 1:
            record.msg, record.args = f"{record.getMessage()} further=left_out_for_{BURST_PERIOD:g}_s", ()
        return passed < BURST


class _Formatter(logging.Formatter):
    def __init__(self, service: str, colour: bool) -> None:
        super().__init__("%(asctime)s level=%(levelname)s %(message)s", datefmt="%H:%M:%S")
        self._prefix = f"{service:<10}| "
        if colour:
            self._prefix = f"\x1b[{_COLOURS.get(service, 32)}m{self._prefix}\x1b[0m"

    def format(self, record: logging.LogRecord) -> str:
        return "\n".join(self._prefix + line for line in super().format(record).splitlines())


def setup_logging(service: str) -> None:
    """Log to standard error with the service's name before each line.

    `ZARM_LOG` is the level (DEBUG, INFO, WARNING, ERROR; default INFO), `ZARM_COLOUR=1` colours the service's name.
    """
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(_Formatter(service, os.environ.get("ZARM_COLOUR") == "1"))
    handler.addFilter(Flood())
    level = os.environ.get("ZARM_LOG", "INFO").upper()
    known = level in logging.getLevelNamesMapping()
    logging.basicConfig(level=level if known else logging.INFO, handlers=[handler], force=True)
    if not known:
        logging.warning("unknown log level ZARM_LOG=%s using=INFO known=DEBUG,INFO,WARNING,ERROR", level)
