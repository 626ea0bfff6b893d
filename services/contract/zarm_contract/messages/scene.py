"""The scene: named objects in the base frame, and the edits that change them."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from zarm_contract._model import Message
from zarm_contract.messages.motion import Name, Positive, Quaternion, Vector3


class Cuboid(Message):
    """A box; `size` are the full edge lengths (m) along its own x, y, z."""

    kind: Literal["cuboid"]
    name: Name
    position: Vector3
    orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    size: tuple[Positive, Positive, Positive]


class Sphere(Message):
    """A ball around `position`."""

    kind: Literal["sphere"]
    name: Name
    position: Vector3
    radius: Positive


class Capsule(Message):
    """All points within `radius` of a segment of `length` (m) along its own z, centred at `position`."""

    kind: Literal["capsule"]
    name: Name
    position: Vector3
    orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    radius: Positive
    length: Positive


class Cylinder(Message):
    """A cylinder with flat ends, `length` (m) along its own z, centred at `position`."""

    kind: Literal["cylinder"]
    name: Name
    position: Vector3
    orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    radius: Positive
    length: Positive


SceneObject = Annotated[Cuboid | Sphere | Capsule | Cylinder, Field(discriminator="kind")]

MAX_OBJECTS = 10_000


class Scene(Message):
    """All objects, in the base frame. `revision` grows by one with every change and never goes back."""

    revision: Annotated[int, Field(ge=0)]
    objects: tuple[SceneObject, ...] = Field(default=(), max_length=MAX_OBJECTS)


class AddObjects(Message):
    """Add objects; a name that exists is refused unless `replace`."""

    op: Literal["add"]
    objects: tuple[SceneObject, ...] = Field(min_length=1, max_length=MAX_OBJECTS)
    replace: bool = False


class RemoveObjects(Message):
    """Remove objects by name; an unknown name is refused."""

    op: Literal["remove"]
    names: tuple[Name, ...] = Field(min_length=1)


class ClearScene(Message):
    """Remove every object."""

    op: Literal["clear"]


class LoadScene(Message):
    """Replace every object at once."""

    op: Literal["load"]
    objects: tuple[SceneObject, ...] = Field(max_length=MAX_OBJECTS)


class SceneEdit(Message):
    """One change of the scene, applied whole or not at all."""

    edit: Annotated[AddObjects | RemoveObjects | ClearScene | LoadScene, Field(discriminator="op")]


class SceneEdited(Message):
    """The scene's revision after the edit, and how many objects it holds."""

    revision: Annotated[int, Field(ge=0)]
    count: Annotated[int, Field(ge=0)]
