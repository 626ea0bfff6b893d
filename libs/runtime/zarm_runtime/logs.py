"""Logs: one line per event on standard error: `service | HH:MM:SS level=... event key=value`, or a JSON object."""

from __future__ import annotations

import json
import logging
import os
import re
import sys
import time
from datetime import UTC, datetime

_COLOURS = {"planner": 36, "executor": 33, "ros_bridge": 35}


BURST = 20
BURST_PERIOD = 10.0
"""Period (s) in which the warnings of one kind are limited, so that a faulty client does not fill the disk."""


class Flood(logging.Filter):
    """Passes the first `BURST` warnings or errors that one line of code logs in `BURST_PERIOD` s; the last one says so."""

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


_KEY = re.compile(r"(?:^|\s)(?=[A-Za-z_][\w-]*=)")
_SPEC = re.compile(r"%[-+ #0]*\d*(?:\.\d+)?[a-zA-Z%]")


class _JsonFormatter(logging.Formatter):
    """`event key=%s` with its values becomes `{"message": "event", "fields": {"key": value}}`, numbers as numbers."""

    def __init__(self, service: str) -> None:
        super().__init__()
        self._service = service
        self.robot: str | None = None

    def format(self, record: logging.LogRecord) -> str:
        event, fields = _taken_apart(record)
        line: dict[str, object] = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname,
            "service": self._service,
            "robot": self.robot,
            "message": event,
            "fields": fields,
        }
        if record.exc_info:
            line["trace"] = self.formatException(record.exc_info)
        return json.dumps({name: value for name, value in line.items() if value is not None})


def _taken_apart(record: logging.LogRecord) -> tuple[str, dict[str, object]]:
    """The event, and its values."""
    values = list(record.args) if isinstance(record.args, tuple) else []
    if record.args and not values:
        return record.getMessage(), {}

    def filled(template: str) -> object:
        """The next values, inserted into a part of the template; a number alone stays a number."""
        specs = [spec for spec in _SPEC.findall(template) if spec != "%%"] if record.args else []
        taken = tuple(values.pop(0) for _ in specs)
        if len(taken) == 1 and template == specs[0] and isinstance(taken[0], int | float):
            return taken[0]
        return template % taken if record.args else template

    event, fields = "", {}
    for part in _KEY.split(str(record.msg)):
        key, equals, template = part.partition("=")
        if equals and re.fullmatch(r"[A-Za-z_][\w-]*", key):
            fields[key] = filled(template)
        else:
            event += str(filled(part))
    return event, fields


def name_robot(robot: str) -> None:
    """From now on name this process's robot in every JSON line."""
    for handler in logging.getLogger().handlers:
        if isinstance(handler.formatter, _JsonFormatter):
            handler.formatter.robot = robot


def setup_logging(service: str) -> None:
    """Log to standard error with the service's name before each line.

    `ZARM_LOG` is the level (DEBUG, INFO, WARNING, ERROR; default INFO), `ZARM_COLOUR=1` colours the service's name.
    `ZARM_LOG_FORMAT=json`: each line is a JSON object with time, level, service, robot, message and fields.
    """
    handler = logging.StreamHandler(sys.stderr)
    form = os.environ.get("ZARM_LOG_FORMAT", "text")
    if form == "json":
        handler.setFormatter(_JsonFormatter(service))
    else:
        handler.setFormatter(_Formatter(service, os.environ.get("ZARM_COLOUR") == "1"))
    handler.addFilter(Flood())
    level = os.environ.get("ZARM_LOG", "INFO").upper()
    known = level in logging.getLevelNamesMapping()
    logging.basicConfig(level=level if known else logging.INFO, handlers=[handler], force=True)
    if not known:
        logging.warning("unknown log level ZARM_LOG=%s using=INFO known=DEBUG,INFO,WARNING,ERROR", level)
    if form not in ("text", "json"):
        logging.warning("unknown log format ZARM_LOG_FORMAT=%s using=text known=text,json", form)
