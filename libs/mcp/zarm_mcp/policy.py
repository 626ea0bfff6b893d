"""What an agent may do: a YAML file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from zarm_contract.messages import Cuboid, Positive, Quaternion, Scale, SceneObject, Vector3
from zarm_contract.section import Section, read_section

Approved = Literal[
    "add_object",
    "remove_object",
    "plan_to_pose",
    "plan_to_joints",
    "plan_home",
    "execute",
    "pick",
    "place",
    "move_gripper",
    "set_speed",
]
"""A tool that a person may have to approve."""
_WALL, _WIDE = 2.0, 40.0
"""Thickness and width (m) of the walls around a workspace."""


class Workspace(Section):
    """A box, in the frame of the base, that no part of the arm leaves."""

    lower: Vector3
    """Its least coordinates (m)."""
    upper: Vector3
    """Its greatest coordinates (m)."""

    @model_validator(mode="after")
    def _not_empty(self) -> Workspace:
        if not all(low < high for low, high in zip(self.lower, self.upper, strict=True)):
            raise ValueError("each of `lower` is less than that of `upper`")
        return self

    def walls(self) -> list[Cuboid]:
        """The walls around it."""
        walls = []
        for axis, name in enumerate("xyz"):
            for side, bound, sign in (("lower", self.lower[axis], -1.0), ("upper", self.upper[axis], 1.0)):
                place, size = [0.0, 0.0, 0.0], [_WIDE, _WIDE, _WIDE]
                place[axis], size[axis] = bound + sign * _WALL / 2, _WALL
                (x, y, z), (a, b, c) = place, size
                walls.append(Cuboid(kind="cuboid", name=f"{name}_{side}", position=(x, y, z), size=(a, b, c)))
        return walls


class Zone(Section):
    """A box that no part of the arm enters."""

    position: Vector3
    """Of its centre, in the frame of the base (m)."""
    orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    size: tuple[Positive, Positive, Positive]
    """Edge lengths (m)."""


class Policy(Section):
    """What an agent may do with a robot."""

    workspace: Workspace | None = None
    """Left out: wherever the arm reaches."""
    keep_out: dict[str, Zone] = Field(default={}, max_length=100)
    """Zones by name. Plans lead around them, as `zarm mcp` puts them into the scene."""
    joint_speed: Scale = 0.3
    """Share of the joints' velocity limits."""
    tool_speed: Positive = 0.25
    """Greatest speed of the tip (m/s)."""
    approval: tuple[Approved, ...] = ("execute", "pick", "place")
    """Tools of which a person has to approve each call."""
    approval_timeout: Positive = 60.0
    """How long a person has for that (s)."""
    edit_scene: bool = True
    """Whether the agent may add objects to the scene, and remove those that it has added."""
    calls_per_minute: Annotated[int, Field(ge=1)] = 120
    """More are refused, except `stop`."""

    def zones(self) -> list[SceneObject]:
        """The zones as objects of the scene."""
        return [
            Cuboid(
                kind="cuboid",
                name=zone_name(name),
                position=zone.position,
                orientation=zone.orientation,
                size=zone.size,
            )
            for name, zone in self.keep_out.items()
        ]


def zone_name(name: str) -> str:
    """The name in the scene of a zone."""
    return f"keep_out.{name}"


def read_policy(path: Path) -> Policy:
    """A policy from a file. Raises InvalidRequest with file and line, one line per fault."""
    return read_section(path, "policy", Policy)[1]
