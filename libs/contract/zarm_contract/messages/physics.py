"""What really happens in a simulation with physics."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from zarm_contract._model import ShortMessage
from zarm_contract.messages.motion import Joints, Name, NonNegative, Quaternion, Vector3

MAX_CONTACTS = 200
MAX_BODIES = 1000


class BodyPose(ShortMessage):
    """Where a thing that moves freely is, in the base frame (m)."""

    name: Name
    position: Vector3
    orientation: Quaternion


class Contact(ShortMessage):
    """Two links, objects or the `floor` that press on each other at `position` (m, base frame), with this `force` (N) along
    the normal.
    """

    first: str
    second: str
    position: Vector3
    force: NonNegative


class PhysicsState(ShortMessage):
    """The truth of a simulation after `time` s of simulated time: the joints (rad, rad/s) in the descriptor's order, the torques of the drives
    (Nm), what moves freely, and what contacts. `real_time_factor` is simulated time per time, over the last second.
    """

    stamp: float
    time: NonNegative
    real_time_factor: NonNegative
    position: Joints
    velocity: Joints
    effort: Joints
    bodies: tuple[BodyPose, ...] = Field(default=(), max_length=MAX_BODIES)
    contacts: Annotated[tuple[Contact, ...], Field(max_length=MAX_CONTACTS)] = ()
