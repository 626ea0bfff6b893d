"""The clock of a cell: that of the machine or, in a simulation, one that runs `speed` times as fast.

Motions, stamps and the timeouts of drivers are in seconds of this clock; computing, and waiting for other programs, in real ones. All
processes of a machine agree on the time, as what passes faster is the time since the machine was started. Real robots are
moved in real time alone: see `DriverLink` of the executor.
"""

from __future__ import annotations

import os
import time

from zarm_contract.errors import InvalidRequest

MAX_SPEED = 20.0
"""Greatest speed: a control period of 10 ms then lasts 0.5 ms, the least that a process wakes up in time for."""

_UNDISTURBED = 5e-6
"""Longest time (s) between two readings of a clock in which no other thread ran."""
_TRIES = 5

speed = 1.0
"""Seconds of this clock per second of the machine's."""


def read_speed() -> None:
    """Take the speed from `ZARM_SIM_SPEED`, if that is set. Raises InvalidRequest for another value than 1 to `MAX_SPEED`."""
    global speed
    text = os.environ.get("ZARM_SIM_SPEED") or "1"
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 1.0 <= value <= MAX_SPEED:
        raise InvalidRequest(
            f"{text} is no speed of a simulation; give a number from 1 (real time) to {MAX_SPEED:g}",
            field="ZARM_SIM_SPEED",
        )
    speed = value


def monotonic() -> float:
    """Time (s) that never goes back, from an arbitrary start."""
    return speed * time.monotonic()


def unix_time() -> float:
    """The time of day (Unix s), as in stamps."""
    return time.time() + (speed - 1.0) * time.monotonic()


def unix_time_of(moment: float) -> float:
    """The time of day (Unix s) of a `moment` (s) of `monotonic`, by the current offset of the two.

    The clocks are read again if another thread ran in between, which would make the moment seem earlier by as much: 0.1
    ms is 1 % of the velocity between two ticks of 10 ms.
    """
    for _ in range(_TRIES):
        before = time.monotonic()
        day = unix_time()
        after = time.monotonic()
        if after - before < _UNDISTURBED:
            break
    return day + moment - speed * (before + after) / 2


def sleep(seconds: float) -> None:
    """Sleep until that much time of this clock has passed."""
    time.sleep(seconds / speed)


def real_seconds(seconds: float) -> float:
    """How long (s) the machine takes for that much time of this clock: for the timeout of a wait."""
    return seconds / speed
