"""Whether the processes on a bus are compatible: which differ in what, and the remedy."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

from zarm_contract.codec import CONTRACT
from zarm_contract.messages import Health
from zarm_runtime.version import version

HERE = "this command"


@dataclass(frozen=True)
class Mismatch:
    """Which processes differ in what. A `harmless` mismatch prevents no communication, as in the middle of an update."""

    kind: Literal["contract", "robot", "version"]
    message: str

    @property
    def harmless(self) -> bool:
        """Whether all still work together."""
        return self.kind == "version"


def mismatches(services: Mapping[str, Health]) -> Iterator[Mismatch]:
    """The differences between these services, and between them and this command."""
    contracts = {name: health.contract for name, health in services.items()} | {HERE: CONTRACT}
    robots = {name: health.robot_hash for name, health in services.items()}
    versions = {name: health.version for name, health in services.items()} | {HERE: version()}
    if len(set(contracts.values())) > 1:
        yield Mismatch(
            "contract",
            f"the services have different contracts: {_grouped(contracts)}. They refuse each other's requests; install one version "
            "of zarm everywhere, then restart the ones that differ",
        )
    if len(set(robots.values())) > 1:
        yield Mismatch(
            "robot",
            f"the services have different files of the robot: {_grouped(robots)}. Motions would be checked against another "
            "robot than the one that moves; give all of them the same descriptor and URDF, then restart them",
        )
    if len(set(versions.values())) > 1:
        yield Mismatch(
            "version",
            f"different versions of zarm run: {_grouped(versions)}. They understand each other; finish the update",
        )


def _grouped(values: Mapping[str, str]) -> str:
    """`v1 by planner and executor, v2 by ros_bridge`."""
    return ", ".join(
        f"{value} by {' and '.join(name for name, other in values.items() if other == value)}"
        for value in dict.fromkeys(values.values())
    )
