"""What the tests of the bus share."""

from __future__ import annotations

from contextlib import suppress

from support.harness import PATIENCE
from zarm_contract.errors import Unavailable
from zarm_contract.messages import Nothing
from zarm_runtime.bus import Bus


def declared(bus: Bus) -> None:
    """Wait until the router has what `bus` has declared and published so far: it answers a session in order.

    It takes a question of the same priority as data: what is asked about liveliness overtakes publications.
    """
    with suppress(Unavailable):
        bus.read("zarm/nobody/nothing", Nothing, timeout=PATIENCE)
