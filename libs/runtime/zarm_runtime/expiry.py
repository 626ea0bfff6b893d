"""Late commands: the process that passes commands to the driver drops them."""

from __future__ import annotations

import threading
from collections import deque

from zarm_contract.messages import DriverCommand

_STATES_KEPT = 1024
"""Joint states whose time is known: 10 s of them at 100 Hz, 1 s at 1 kHz."""


class Expiry:
    """Tells commands that are in time from late ones. Each process that passes commands to a robot has one, and drops
    late ones.

    A stalled link holds commands up and delivers them seconds later. The two sides need no common clock: a command
    names a joint state of the driver's own by its stamp, and how long after that it may begin. All times (s) are on one
    clock of the driver's side, which must not be stepped.
    """

    def __init__(self) -> None:
        self._reports: deque[tuple[float, float]] = deque(maxlen=_STATES_KEPT)
        self._lock = threading.Lock()

    def report(self, stamp: float, now: float) -> None:
        """A joint state with this stamp was reported at `now`."""
        with self._lock:
            self._reports.append((stamp, now))

    def in_time(self, command: DriverCommand, arrived: float) -> bool:
        """Whether a command that arrived at that time may begin. A stop always may.

        For an unknown stamp, the previous known one counts: another program may republish the joints with its own
        stamps.
        """
        based_on, expires_after = command.based_on, command.expires_after
        if not command.time:
            return True
        if based_on is None or expires_after is None:
            return False
        with self._lock:
            report = next((moment for stamp, moment in reversed(self._reports) if stamp <= based_on), None)
        return report is not None and arrived - report <= expires_after
