"""What the tests of the bus share."""

from __future__ import annotations

from zarm_contract.bus import Bus
from zarm_contract.keys import ALL_ALIVE


def declared(bus: Bus) -> None:
    """Wait until the router knows what `bus` has declared so far: it answers a session in order."""
    bus.alive(ALL_ALIVE)
