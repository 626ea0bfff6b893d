"""The scene: named objects in the base frame, and the edits that change them."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from zarm_contract._model import Message, ShortMessage
from zarm_contract.messages.motion import Joints, Name, Positive, Quaternion, Vector3

MAX_OBJECTS = 10_000
MAX_ATTACHED = 16
MAX_CELLS = 200_000
MAX_POINTS = 200_000
MAX_INDEX = 500_000
"""No cell is further from that at the origin, along any axis."""


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


class Mesh(Message):
    """Triangles from an STL or OBJ `file` (m), a path inside one of the planner's mesh folders; a closed mesh is solid.

    `sha256` is that of the file's content. The scene fills it in, and refuses a file with another one.
    """

    kind: Literal["mesh"]
    name: Name
    position: Vector3
    orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    file: Annotated[str, Field(min_length=1, max_length=255)]
    scale: tuple[Positive, Positive, Positive] = (1.0, 1.0, 1.0)
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")] | None = None


Resolution = Annotated[float, Field(ge=0.002, le=1)]


Index = Annotated[int, Field(ge=-MAX_INDEX, le=MAX_INDEX)]


class Voxels(Message):
    """Occupied cubes with edges of `resolution` m: cell `(i, j, k)` has its centre at `(i, j, k) * resolution`."""

    kind: Literal["voxels"]
    name: Name
    position: Vector3 = (0.0, 0.0, 0.0)
    orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    resolution: Resolution
    cells: tuple[tuple[Index, Index, Index], ...] = Field(min_length=1, max_length=MAX_CELLS)


class PointCloud(Message):
    """Points (m) that are obstacles; the scene keeps the voxels of `resolution` m that they lie in."""

    kind: Literal["cloud"]
    name: Name
    position: Vector3 = (0.0, 0.0, 0.0)
    orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    resolution: Resolution = 0.02
    points: tuple[Vector3, ...] = Field(min_length=1, max_length=MAX_POINTS)


Primitive = Annotated[Cuboid | Sphere | Capsule | Cylinder, Field(discriminator="kind")]
SceneObject = Annotated[Cuboid | Sphere | Capsule | Cylinder | Mesh | Voxels, Field(discriminator="kind")]


class Attached(Message):
    """An object that the robot carries: its pose is in the frame of the tip; it may touch `touch_links`."""

    object: Primitive
    touch_links: tuple[str, ...] = ()


SceneRevision = Annotated[str, Field(pattern=r"^(0|[1-9][0-9]{0,17})-[0-9a-f]{12}$")]
"""Names one state of one scene, `7-5be0c1d2f3a4`: how many edits it has had, for people, and an identity drawn at random
with every edit. Equal revisions mean the same scene; which of two is newer, or whether they are of one planner, nothing says."""


class Scene(Message):
    """All objects, in the base frame, and what the robot carries. `revision` never comes again once the scene has changed.

    `ignored_links` are those of the robot whose collisions are not looked at.
    """

    revision: SceneRevision
    objects: tuple[SceneObject, ...] = Field(default=(), max_length=MAX_OBJECTS)
    attached: tuple[Attached, ...] = Field(default=(), max_length=MAX_ATTACHED)
    ignored_links: tuple[str, ...] = ()


class AddObjects(Message):
    """Add objects; a name that exists is refused unless `replace`, that of a carried object always."""

    op: Literal["add"]
    objects: tuple[Annotated[SceneObject | PointCloud, Field(discriminator="kind")], ...] = Field(
        min_length=1, max_length=MAX_OBJECTS
    )
    replace: bool = False


class RemoveObjects(Message):
    """Remove objects by name; an unknown name is refused, and that of a carried object: detach it first."""

    op: Literal["remove"]
    names: tuple[Name, ...] = Field(min_length=1)


class ClearScene(Message):
    """Remove every object; what is attached, and which links are ignored, stays."""

    op: Literal["clear"]


class LoadScene(Message):
    """Replace every object at once; what is attached, and which links are ignored, stays. Names must not be carried ones."""

    op: Literal["load"]
    objects: tuple[SceneObject, ...] = Field(max_length=MAX_OBJECTS)


class AttachObject(Message):
    """From now on the robot carries an object of the scene; it keeps its place seen from the tip at `joints`.

    `joints` left out are the measured ones. The object may touch `touch_links`, as a gripper's fingers; links on one rigid
    body with the tip are never checked against it. Meshes and voxels cannot be carried.
    """

    op: Literal["attach"]
    name: Name
    touch_links: tuple[str, ...] = Field(default=(), max_length=32)
    joints: Joints | None = None


class DetachObject(Message):
    """Put a carried object down where it is with the robot at `joints` (left out: the measured ones)."""

    op: Literal["detach"]
    name: Name
    joints: Joints | None = None


class SetLinkCollision(Message):
    """Look at the collisions of these links of the robot, or no longer; one link at least stays."""

    op: Literal["links"]
    names: tuple[str, ...] = Field(min_length=1, max_length=64)
    enabled: bool


class SceneEdit(Message):
    """One change of the scene, applied whole or not at all."""

    edit: Annotated[
        AddObjects | RemoveObjects | ClearScene | LoadScene | AttachObject | DetachObject | SetLinkCollision,
        Field(discriminator="op"),
    ]


class SceneEdited(ShortMessage):
    """The scene's revision after the edit, and how many objects it holds."""

    revision: SceneRevision
    count: Annotated[int, Field(ge=0)]


class OccupancyRequest(Message):
    """Ask which cubes with edges of `resolution` m the scene's objects reach into."""

    resolution: Resolution = 0.05


class Occupancy(Message):
    """The cells that the objects reach into, each once; `(i, j, k)` has its centre at `(i, j, k) * resolution` in the base frame.

    No part of an object is outside them. What the robot carries is not there.
    """

    scene_revision: SceneRevision
    resolution: Resolution
    cells: tuple[tuple[Index, Index, Index], ...] = Field(max_length=MAX_CELLS)
