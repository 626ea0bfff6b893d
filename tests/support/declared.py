"""Shared code of the tests of the bus."""

from __future__ import annotations

from contextlib import suppress

from support.harness import PATIENCE
from zarm_contract.errors import Unavailable
from zarm_contract.key import Query
from zarm_contract.messages import Nothing
from zarm_contract.roles import EVERYONE
from zarm_runtime.bus import Bus

_NOBODYS = Query("planner/nothing", Nothing, Nothing, "Nobody answers.", by=EVERYONE).of_robot("nobody")


def declared(bus: Bus) -> None:
    """Wait until the router has everything that `bus` has declared and published so far: it answers a session in order.

    The query must have the same priority as data: liveliness queries overtake publications.
    """
    with suppress(Unavailable):
        bus.call(_NOBODYS, Nothing(), timeout=PATIENCE)
