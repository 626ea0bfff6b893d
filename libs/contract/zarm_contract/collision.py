"""The exact geometry of a link, as a robot descriptor gives it."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from zarm_contract.messages import Positive, Quaternion, Vector3
from zarm_contract.section import Section


class CollisionSphere(Section):
    """A ball of `radius` m around `center` in its link's frame."""

    kind: Literal["sphere"] = "sphere"
    """May be left out for a sphere."""
    center: Vector3
    """Centre in the frame of the link (m)."""
    radius: Positive
    """Radius (m)."""


class CollisionCapsule(Section):
    """All points within `radius` m of the segment `a`-`b` in the link's frame."""

    kind: Literal["capsule"]
    a: Vector3
    """One end of the segment, in the frame of the link (m)."""
    b: Vector3
    """The other end (m)."""
    radius: Positive
    """The capsule is every point within this distance of the segment (m)."""


class CollisionCylinder(Section):
    """A flat-ended cylinder; `a` and `b` are the centres of its end faces in the link's frame."""

    kind: Literal["cylinder"]
    a: Vector3
    """Centre of one end face, in the frame of the link (m)."""
    b: Vector3
    """Centre of the other (m)."""
    radius: Positive
    """Radius (m)."""


class CollisionCuboid(Section):
    """A box of full edge lengths `size` m, centred at `center` and turned by `orientation` in the link's frame."""

    kind: Literal["cuboid"]
    center: Vector3
    """Centre in the frame of the link (m)."""
    orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    """Rotation in the frame of the link, `[x, y, z, w]`."""
    size: tuple[Positive, Positive, Positive]
    """Full edge lengths along its own x, y, z (m)."""


CollisionPrimitive = Annotated[
    CollisionSphere | CollisionCapsule | CollisionCylinder | CollisionCuboid, Field(discriminator="kind")
]
