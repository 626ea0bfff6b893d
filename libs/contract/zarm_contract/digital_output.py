"""The digital outputs of a robot descriptor."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from zarm_contract.messages import MAX_OUTPUT_TIMEOUT
from zarm_contract.section import Section


class DigitalOutput(Section):
    """Something that is switched on and off: a valve, a lamp, a welding torch."""

    service: Annotated[str, Field(min_length=1)] | None = None
    """ROS service of the type `std_srvs/srv/SetBool` that switches it. Left out: commands go to `driver/output/command` on Zenoh only."""
    driver_timeout: Annotated[float, Field(gt=0.0, le=MAX_OUTPUT_TIMEOUT)] = 2.0
    """How long the driver may take to confirm (s)."""
