"""The list of control strategies that move a robot through its driver."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import AfterValidator

DRIVER_STRATEGIES: Mapping[str, Literal["chunks", "whole"]] = {
    "joint_speed": "chunks",
    "joint_pose": "chunks",
    "joint_trajectory": "whole",
}
"""How each hands a motion to the driver: in chunks that follow one another, or as a whole.

Each is the class of this name in the module of this name in `zarm_executor.strategies`.
"""

EXECUTORS = "executors"
"""The strategy of a robot of several robots, which moves each through an executor of its own."""


def _known(name: str) -> str:
    if name not in DRIVER_STRATEGIES:
        raise ValueError(f"there is no strategy {name!r} for drivers; choose among {', '.join(DRIVER_STRATEGIES)}")
    return name


DriverStrategyName = Annotated[str, AfterValidator(_known)]
