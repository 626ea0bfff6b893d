"""The world of a simulation with physics, and what really happens there."""

from __future__ import annotations

from base64 import b64decode
from typing import Annotated

from pydantic import AfterValidator, Field

from zarm_contract._model import Message, ShortMessage
from zarm_contract.messages.motion import Joints, Name, NonNegative, Positive, Quaternion, Vector3
from zarm_contract.messages.scene import SceneObject

MAX_CONTACTS = 200
MAX_BODIES = 1000
PNG = b"\x89PNG\r\n\x1a\n"
"""How a PNG file begins."""


def _png(image: str) -> str:
    try:
        known = b64decode(image, validate=True).startswith(PNG)
    except ValueError as error:
        raise ValueError("not base64") from error
    if not known:
        raise ValueError("not a PNG file")
    return image


class DynamicObject(ShortMessage):
    """An object that moves when it is pushed, with its `mass` (kg), spread evenly, and the coefficient of its sliding `friction`; of two
    objects that touch, the larger one counts.
    """

    name: Name
    mass: Positive
    friction: NonNegative = 1.0


class Conveyor(ShortMessage):
    """A fixed object whose surface runs along its own x axis with this `speed` (m/s), and takes along what lies on it."""

    name: Name
    speed: float


class Texture(ShortMessage):
    """What the cuboid `name` looks like to cameras: a picture on its +z and -z faces, with the first row towards +y. `image` is a PNG
    in base64.
    """

    name: Name
    image: Annotated[str, AfterValidator(_png)]


class MovingObjects(ShortMessage):
    """Objects that move together along a `path` of displacements (m, base frame) from where they are described, with this `speed` (m/s),
    whatever is in their way. They come back and go again, or with `once` stay at the end.
    """

    names: Annotated[tuple[Name, ...], Field(min_length=1, max_length=MAX_BODIES)]
    path: Annotated[tuple[Vector3, ...], Field(min_length=2, max_length=1000)]
    speed: Positive
    once: bool = False


class LoadWorld(Message):
    """Replace the world of a simulation: `objects` in the base frame, and a floor without end at the height `floor` (m), if given. Objects
    are fixed unless they are dynamic or moving; meshes have no body. Objects of the scene have no body then, but where a world is empty. With `add` the
    objects join those that are there, which stay where they are.
    """

    objects: tuple[SceneObject, ...] = Field(default=(), max_length=MAX_BODIES)
    floor: float | None = None
    dynamic: tuple[DynamicObject, ...] = Field(default=(), max_length=MAX_BODIES)
    conveyors: tuple[Conveyor, ...] = Field(default=(), max_length=MAX_BODIES)
    moving: tuple[MovingObjects, ...] = Field(default=(), max_length=MAX_BODIES)
    textures: tuple[Texture, ...] = Field(default=(), max_length=MAX_BODIES)
    add: bool = False


class BodyPose(ShortMessage):
    """Where an object that moves is, in the base frame (m)."""

    name: Name
    position: Vector3
    orientation: Quaternion


class Contact(ShortMessage):
    """Two links, objects or the `floor` that press on each other at `position` (m, base frame), with this `force` (N) along
    the `normal`, which points from the first to the second.
    """

    first: str
    second: str
    position: Vector3
    force: NonNegative
    normal: Vector3 = (0.0, 0.0, 1.0)


class PhysicsObjects(Message):
    """The objects of a simulation, at the poses at which they were described: `PhysicsState` says where those are that move. None if they are those of
    the scene."""

    objects: tuple[SceneObject, ...] = Field(default=(), max_length=MAX_BODIES)


class PhysicsState(ShortMessage):
    """The truth of a simulation after `time` s of simulated time: the joints (rad, rad/s) in the descriptor's order, the torques of the drives
    (Nm), what of the world moves, and what contacts. `real_time_factor` is simulated time per time, over the last second.
    """

    stamp: float
    time: NonNegative
    real_time_factor: NonNegative
    position: Joints
    velocity: Joints
    effort: Joints
    bodies: tuple[BodyPose, ...] = Field(default=(), max_length=MAX_BODIES)
    contacts: Annotated[tuple[Contact, ...], Field(max_length=MAX_CONTACTS)] = ()
