"""The scene: named objects in the base frame, and the edits that change them."""

from __future__ import annotations

import math
import sys
from array import array
from base64 import b64decode
from collections.abc import Iterable
from itertools import chain
from typing import Annotated, Literal

from pydantic import AfterValidator, Discriminator, Field, Tag

from zarm_contract._model import Message, ShortMessage
from zarm_contract.messages.motion import Joints, Name, NonNegative, Positive, Quaternion, Vector3

MAX_OBJECTS = 10_000
MAX_ATTACHED = 16
MAX_TOOL_SHAPES = 8
MAX_ATTACHED_PARTS = 32
VOXEL_MAP = "map"
"""The voxel map in pairs. Its blocks are objects whose names begin with this and a dot."""
MAX_PAIRED = 63
"""Names in the ignored pairs of a scene."""
MAX_CELLS = 200_000
MAX_POINTS = 200_000
MAX_INDEX = 500_000
"""No cell is further from that at the origin, along any axis."""


class Cuboid(Message):
    """A box with full edge lengths `size` (m) along its own x, y, z."""

    kind: Literal["cuboid"]
    name: Name
    position: Vector3
    orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    size: tuple[Positive, Positive, Positive]


class Sphere(Message):
    """A ball of `radius` (m) around `position` (m)."""

    kind: Literal["sphere"]
    name: Name
    position: Vector3
    radius: Positive


class Capsule(Message):
    """All points within `radius` (m) of a segment of `length` (m) along its own z, centred at `position` (m)."""

    kind: Literal["capsule"]
    name: Name
    position: Vector3
    orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    radius: Positive
    length: Positive


class Cylinder(Message):
    """A cylinder of `radius` and `length` (m) along its own z, with flat ends, centred at `position` (m)."""

    kind: Literal["cylinder"]
    name: Name
    position: Vector3
    orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    radius: Positive
    length: Positive


class Mesh(Message):
    """Triangles from an STL or OBJ `file`, a path inside a mesh folder of the planner. A closed mesh is solid.

    With `data`, the content of the file in base64, the planner needs no file of this name, up to some 55,000 triangles in binary STL. Numbers
    in the file are m, times `scale`. The scene fills in `sha256` of the file and refuses a file that has changed.
    """

    kind: Literal["mesh"]
    name: Name
    position: Vector3
    orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    file: Annotated[str, Field(min_length=1, max_length=255)]
    scale: tuple[Positive, Positive, Positive] = (1.0, 1.0, 1.0)
    data: Annotated[str, Field(max_length=4_000_000)] | None = None
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")] | None = None


Resolution = Annotated[float, Field(ge=0.002, le=1)]


Index = Annotated[int, Field(ge=-MAX_INDEX, le=MAX_INDEX)]


class Voxels(Message):
    """Occupied cubes with edges of `resolution` (m): the centre of cell `(i, j, k)` is at `(i, j, k) * resolution`."""

    kind: Literal["voxels"]
    name: Name
    position: Vector3 = (0.0, 0.0, 0.0)
    orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    resolution: Resolution
    cells: tuple[tuple[Index, Index, Index], ...] = Field(min_length=1, max_length=MAX_CELLS)


def _unpacked(packed: str) -> array[float]:
    found = array("d", b64decode(packed, validate=True))
    if sys.byteorder == "big":
        found.byteswap()
    return found


def _checked(packed: str) -> str:
    try:
        found = _unpacked(packed)
    except ValueError as error:
        raise ValueError("not base64 of 64-bit floats") from error
    if not found or len(found) % 3:
        raise ValueError(f"{len(found)} numbers are not x, y and z of points")
    if not math.isfinite(sum(map(abs, found))):
        raise ValueError("a coordinate is not a finite number")
    return packed


_Listed = Annotated[tuple[Vector3, ...], Field(min_length=1, max_length=MAX_POINTS), Tag("listed")]
_Packed = Annotated[str, Field(max_length=32 * MAX_POINTS), AfterValidator(_checked), Tag("packed")]
Points = Annotated[_Listed | _Packed, Discriminator(lambda points: "packed" if isinstance(points, str) else "listed")]


class PointCloud(Message):
    """Points (m) that are obstacles, up to 200,000. The scene keeps the voxels of `resolution` (m) that contain them.

    `points` are a list or, for a large cloud, packed into a text: x, y, z of each point as little-endian 64-bit floats, in
    base64. So the largest has 6.4 MB.
    """

    kind: Literal["cloud"]
    name: Name
    position: Vector3 = (0.0, 0.0, 0.0)
    orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    resolution: Resolution = 0.02
    points: Points

    def coordinates(self) -> array[float]:
        """x, y, z of each point, one after the other."""
        return _unpacked(self.points) if isinstance(self.points, str) else array("d", chain.from_iterable(self.points))


Primitive = Annotated[Cuboid | Sphere | Capsule | Cylinder, Field(discriminator="kind")]
SceneObject = Annotated[Cuboid | Sphere | Capsule | Cylinder | Mesh | Voxels, Field(discriminator="kind")]


class Attached(Message):
    """An attached object: its pose is relative to the `link`, by default the descriptor's `tip_link`, and it may touch `touch_links`.

    A mesh or voxels are checked by their `parts`, relative to that link, which contain them. `mass` (kg), if known, counts in torques; its `center` is in
    the frame of the object (m; default: the middle). It may be a shape of a mounted `tool`.
    """

    object: SceneObject
    touch_links: tuple[str, ...] = ()
    parts: tuple[Primitive, ...] = Field(default=(), max_length=MAX_ATTACHED_PARTS)
    link: str | None = None
    mass: Positive | None = None
    center: Vector3 | None = None
    tool: Name | None = None


class ObjectPose(ShortMessage):
    """Where an object of the scene was at `stamp` (Unix time, s), in the base frame, and how it moves; its name is in the key.

    The newest `stamp` counts. From there the object moves with `linear` (m/s) and turns with `angular` (rad/s); its true velocity is
    within `speed` (m/s) of that, whatever its direction. For an object that may turn around at any time leave `linear` out and
    give its greatest speed. Publish repeatedly, also for an object at rest: without news the object grows by these speeds for 1 s,
    and is then lost, see `ServoState.lost_objects`. Objects that consist of voxels do not move. An edit of the object itself
    sets its pose again.
    """

    stamp: float
    position: Vector3
    orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    linear: Vector3 = (0.0, 0.0, 0.0)
    angular: Vector3 = (0.0, 0.0, 0.0)
    speed: NonNegative


def tools_of(attached: Iterable[Attached]) -> tuple[str, ...]:
    """The tools among what is attached."""
    return tuple(dict.fromkeys(one.tool for one in attached if one.tool is not None))


SceneRevision = Annotated[str, Field(pattern=r"^(0|[1-9][0-9]{0,17})-[0-9a-f]{12}$")]
"""Names one state of one scene, `7-5be0c1d2f3a4`: how many edits it has had, for people, and an identity drawn at random
with every edit. Equal revisions mean the same scene; which of two is newer, or whether they are of one planner, nothing says."""


class Scene(Message):
    """All objects in the base frame, and the objects attached to the robot, mounted tools among them. A `revision` never repeats.

    Collisions of `ignored_links`, of `ignored_objects`, and of `ignored_pairs` with each other are not checked.
    """

    revision: SceneRevision
    objects: tuple[SceneObject, ...] = Field(default=(), max_length=MAX_OBJECTS)
    attached: tuple[Attached, ...] = Field(default=(), max_length=MAX_ATTACHED)
    ignored_links: tuple[str, ...] = ()
    ignored_objects: tuple[Name, ...] = ()
    ignored_pairs: tuple[tuple[str, str], ...] = ()

    @property
    def obstacles(self) -> tuple[SceneObject, ...]:
        """The objects whose collisions are checked."""
        if not self.ignored_objects:
            return self.objects
        return tuple(item for item in self.objects if item.name not in self.ignored_objects)

    @property
    def carried(self) -> tuple[Attached, ...]:
        """The attached objects whose collisions are checked."""
        if not self.ignored_objects:
            return self.attached
        return tuple(one for one in self.attached if one.object.name not in self.ignored_objects)

    @property
    def tools(self) -> tuple[str, ...]:
        """The tools that are mounted."""
        return tools_of(self.attached)


class AddObjects(Message):
    """Add objects. A name that exists is refused unless `replace` is true; the name of an attached object always is."""

    op: Literal["add"]
    objects: tuple[Annotated[SceneObject | PointCloud, Field(discriminator="kind")], ...] = Field(
        min_length=1, max_length=MAX_OBJECTS
    )
    replace: bool = False


class RemoveObjects(Message):
    """Remove objects by name. Unknown names are refused, and so are attached objects: detach them first."""

    op: Literal["remove"]
    names: tuple[Name, ...] = Field(min_length=1)


class ClearScene(Message):
    """Remove every object. Attached objects, mounted tools and ignored links stay."""

    op: Literal["clear"]


class LoadScene(Message):
    """Replace every object. Attached objects and ignored links stay; the names of attached objects are refused."""

    op: Literal["load"]
    objects: tuple[SceneObject, ...] = Field(max_length=MAX_OBJECTS)


class AttachObject(Message):
    """Attach an object of the scene to a `link`, by default the descriptor's `tip_link`, where it is with the robot at `joints` (rad; default:
    the measured ones).

    The object may touch `touch_links`, such as the fingers of a gripper. It is never checked against links that are fixed to
    that link. A mesh or voxels are carried as at most 32 cuboids that contain them. With its `mass` (kg) plans keep
    the largest torques of the joints, see `PlanTorque`; the `center` of the mass is in the frame of the object (m; default: the middle).
    """

    op: Literal["attach"]
    name: Name
    touch_links: tuple[str, ...] = Field(default=(), max_length=32)
    joints: Joints | None = None
    link: str | None = None
    mass: Positive | None = None
    center: Vector3 | None = None


class DetachObject(Message):
    """Detach an object and leave it where it is with the robot at `joints` (rad; default: the measured ones)."""

    op: Literal["detach"]
    name: Name
    joints: Joints | None = None


class MountTool(Message):
    """Mount a tool of the descriptor on its link, in place of the one that is there. From then on its shapes, `<tool>_1` and so on, are attached, and
    its tip takes the place of that of the robot, or of the groups with that link as `tip_link`. The robot must stand still.
    """

    op: Literal["mount"]
    tool: Name


class UnmountTool(Message):
    """Take a mounted tool off. What it carries has to be detached before. The robot must stand still."""

    op: Literal["unmount"]
    tool: Name


class SetLinkCollision(Message):
    """Check the collisions of these links, or ignore them. At least one link must be checked."""

    op: Literal["links"]
    names: tuple[str, ...] = Field(min_length=1, max_length=64)
    enabled: bool


class SetObjectCollision(Message):
    """Check the collisions of these objects, also of attached ones, or ignore them; they are shown all the same.

    An object that is removed is checked again when it comes back.
    """

    op: Literal["objects"]
    names: tuple[Name, ...] = Field(min_length=1, max_length=MAX_OBJECTS)
    enabled: bool


class SetPairCollision(Message):
    """Check the collisions of these pairs, or ignore them: of a link or an attached object with an object, or of two of the former.

    `map` is the voxel map. A pair is checked again once an object of it is removed. At most 63 different names (MAX_PAIRED) can be in ignored pairs.
    """

    op: Literal["pairs"]
    names: tuple[tuple[str, str], ...] = Field(min_length=1, max_length=1000)
    enabled: bool


SingleEdit = (
    AddObjects
    | RemoveObjects
    | ClearScene
    | LoadScene
    | AttachObject
    | DetachObject
    | MountTool
    | UnmountTool
    | SetLinkCollision
    | SetObjectCollision
    | SetPairCollision
)


class EditBatch(Message):
    """Several edits, one after the other, applied all or not at all."""

    op: Literal["batch"]
    edits: tuple[Annotated[SingleEdit, Field(discriminator="op")], ...] = Field(min_length=1, max_length=1000)


class SceneEdit(Message):
    """One edit of the scene, applied as a whole or not at all."""

    edit: Annotated[SingleEdit | EditBatch, Field(discriminator="op")]

    @property
    def edits(self) -> tuple[SingleEdit, ...]:
        """The edits one by one."""
        return self.edit.edits if isinstance(self.edit, EditBatch) else (self.edit,)


class SceneEdited(ShortMessage):
    """The revision of the scene, its number of objects, and `notes` on the edit.

    A mesh with small faults is repaired, and only the surface of an open one is an obstacle: `notes` say so.
    """

    revision: SceneRevision
    count: Annotated[int, Field(ge=0)]
    notes: tuple[str, ...] = ()


class OccupancyRequest(Message):
    """Ask which cells of a grid with edges of `resolution` (m) contain a part of an object."""

    resolution: Resolution = 0.05


class Occupancy(Message):
    """The occupied cells; the centre of `(i, j, k)` is at `(i, j, k) * resolution` in the base frame.

    They cover every object completely. Attached objects are not included.
    """

    scene_revision: SceneRevision
    resolution: Resolution
    cells: tuple[tuple[Index, Index, Index], ...] = Field(max_length=MAX_CELLS)
