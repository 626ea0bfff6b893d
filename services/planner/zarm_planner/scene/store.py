"""The scene: named objects, changed by atomic edits, in a file that survives a crash at any moment."""

from __future__ import annotations

import logging
import secrets
import threading
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Any, assert_never

import numpy as np

from zarm_contract.codec import MAX_BYTES, encode
from zarm_contract.errors import InvalidRequest, Unavailable
from zarm_contract.messages import (
    MAX_OBJECTS,
    AddObjects,
    AttachObject,
    ClearScene,
    Cuboid,
    DetachObject,
    EditBatch,
    LoadScene,
    Mesh,
    MountTool,
    PointCloud,
    RemoveObjects,
    Scene,
    SceneEdit,
    SceneObject,
    SceneRevision,
    SetLinkCollision,
    SetObjectCollision,
    SetPairCollision,
    SingleEdit,
    Sphere,
    UnmountTool,
    Voxels,
)
from zarm_geometry.meshes import Meshes
from zarm_geometry.voxels import cells_of, check_reach, voxels_of
from zarm_planner.scene.attached_objects import attach, detach, refuse_attached
from zarm_planner.scene.ignored_collisions import set_links, set_objects, set_pairs, without_gone
from zarm_planner.scene.tools import Tools, unmount
from zarm_runtime.state_file import StateFile
from zarm_trajectory.arrays import Array

log = logging.getLogger(__name__)


Complete = Callable[[Scene, SingleEdit], tuple[SingleEdit, Array]]

_AT_BASE = np.eye(4)
_IGNORING = SetLinkCollision | SetObjectCollision | SetPairCollision
_MAX_DISTANCE = 1e3
_MIN_THICKNESS = 1e-4
MAX_PARTS = 300_000
"""Objects, occupied cells and shapes of meshes in one scene."""


def _named(document: Any) -> Any:
    """Migrates the document of a version 0 file."""
    return document["scene"]


def _identified(scene: Any) -> Any:
    """Migrates a version 1 scene, whose revision was only a number, by giving it an identity."""
    return scene | {"revision": _revision(scene["revision"])}


def _revision(edits: int) -> SceneRevision:
    """A new, unique revision of a scene with this number of edits."""
    return f"{edits}-{secrets.token_hex(6)}"


def _next(revision: SceneRevision) -> SceneRevision:
    edits, _, _ = revision.partition("-")
    return _revision(int(edits) + 1)


class SceneStore:
    """The scene of a robot with these `links` and `tools`, in `<folder>/scene.json`, with the shapes of its meshes. Thread-safe.

    Each edit draws a new revision, which is kept in the file: the revision of a scene read from the file is valid
    again, and that of a missing or lost file is never reused. A copy of the file that is edited elsewhere becomes
    another scene. A file that cannot be read is set aside as `scene.json.broken`. From then on `lost` says so until the
    first edit, because the objects in it may still stand around the robot.
    """

    def __init__(
        self, folder: Path, meshes: Meshes | None = None, links: Collection[str] = (), tools: Tools | None = None
    ) -> None:
        """Raises Unavailable if the folder cannot be used, or holds the scene of a newer zarm, or one with an unknown tool."""
        self._file = StateFile(folder / "scene.json", Scene, migrations=(_named, _identified), flushed=True)
        self._lock = threading.Lock()
        self._links, self._tools = frozenset(links), tools or Tools()
        self.meshes = meshes or Meshes()
        self.lost: str | None = None
        self._scene = self._read()

    @property
    def scene(self) -> Scene:
        """The present scene, which is immutable; an edit makes a new one."""
        return self._scene

    def edit(
        self,
        request: SceneEdit,
        complete: Complete = lambda _, edit: (edit, _AT_BASE),
        prepare: Callable[[Scene], None] = lambda _: None,
    ) -> Scene:
        """Apply an edit, save the result and return it. `complete` checks each single edit of a scene, and fills it in; it also gives the
        pose (4, 4) of the link to which an object is attached, or from which it is detached.

        `prepare` is called with the new scene before it takes effect. Raises InvalidRequest for a faulty edit and
        Unavailable if it cannot be saved, or concerns links while the scene is lost; then nothing has changed.
        """
        with self._lock:
            if self.lost is not None and all(isinstance(edit, _IGNORING) for edit in request.edits):
                raise Unavailable(self.lost)  # such an edit says nothing about the objects around the robot
            scene = self._scene
            for index, edit in enumerate(request.edits):
                try:
                    scene = self._edited(scene, *complete(scene, edit))
                except InvalidRequest as error:
                    if not isinstance(request.edit, EditBatch):
                        raise
                    raise _of_batch(error, index) from error
            scene = scene.model_copy(update={"revision": _next(self._scene.revision)})
            content = encode(scene)
            if len(content) > MAX_BYTES:
                raise InvalidRequest(
                    f"the scene would take {len(content)} bytes, more than the {MAX_BYTES} of one message; remove objects "
                    "first, or use a coarser resolution",
                    field="edit.objects",
                )
            prepare(scene)
            try:
                self._file.write(content)
            except Unavailable as error:
                raise Unavailable(f"the edit was not applied: {error}; then send it again") from error
            self._scene, self.lost = scene, None
            carried = (one.object for one in scene.attached)
            self.meshes.keep(item for item in (*scene.objects, *carried) if isinstance(item, Mesh))
            return scene

    def notes(self, request: SceneEdit) -> tuple[str, ...]:
        """Notes on the meshes that an edit has added."""
        names = {
            item.name for edit in request.edits if isinstance(edit, AddObjects | LoadScene) for item in edit.objects
        }
        meshes = [item for item in self._scene.objects if isinstance(item, Mesh) and item.name in names]
        return tuple(note for item in meshes for note in self.meshes.notes(item))

    def _read(self) -> Scene:
        saved = self._file.load()
        if saved is not None:
            scene = self._tools.renewed(saved)
            return (
                saved if scene == saved else self._saved(scene.model_copy(update={"revision": _next(saved.revision)}))
            )
        new = Scene(revision=_revision(0))
        broken = self._file.broken
        if broken is None:
            return self._saved(new)
        self.lost = (
            f"the saved scene could not be read and lies in {broken}; plans are refused until the scene is edited: "
            "load or add what stands around the robot, or clear it if nothing does"
        )
        log.error("scene lost remedy=%s", self.lost)
        return new

    def _edited(self, scene: Scene, edit: SingleEdit, tip: Array) -> Scene:
        """A scene after an edit."""
        if isinstance(edit, AddObjects | LoadScene):
            _refuse_links(edit.objects, self._links)
        edited = _edited(scene, edit, tip, self.meshes, self._tools, self._links)
        return without_gone(edited, self._links)

    def _saved(self, scene: Scene) -> Scene:
        self._file.save(scene)
        return scene


def _of_batch(error: InvalidRequest, index: int) -> InvalidRequest:
    """A fault of an edit as one of the batch that it is in."""
    place = f"edit.edits.{index}"
    return InvalidRequest(error.problem.message, field=(error.problem.field or "edit").replace("edit", place, 1))


def _edited(scene: Scene, edit: SingleEdit, tip: Array, meshes: Meshes, tools: Tools, links: Collection[str]) -> Scene:
    """The scene after an edit, not yet with its own revision; objects stay in their order."""
    objects = {item.name: item for item in scene.objects}
    match edit:
        case AttachObject():
            return attach(scene, edit, tip, meshes)
        case DetachObject():
            return detach(scene, edit, tip)
        case MountTool():
            return tools.mount(scene, edit.tool)
        case UnmountTool():
            return unmount(scene, edit.tool)
        case SetLinkCollision():
            return set_links(scene, edit)
        case SetObjectCollision():
            return set_objects(scene, edit)
        case SetPairCollision():
            return set_pairs(scene, edit, links)
        case ClearScene():
            objects = {}
        case RemoveObjects(names=names):
            refuse_attached(scene, names, "edit.names.{}")
            for index, name in enumerate(names):
                if name not in objects:
                    raise InvalidRequest(
                        f"there is no object {name} in the scene; read the names from the scene first",
                        field=f"edit.names.{index}",
                    )
            objects = {name: item for name, item in objects.items() if name not in names}
        case LoadScene(objects=items):
            refuse_attached(scene, [item.name for item in items], "edit.objects.{}.name")
            objects = _added({}, items, False, meshes)
        case AddObjects(objects=items, replace=replace):
            refuse_attached(scene, [item.name for item in items], "edit.objects.{}.name")
            objects = _added(objects, items, replace, meshes)
        case unknown:
            assert_never(unknown)
    return scene.model_copy(update={"objects": tuple(objects.values())})


def _refuse_links(items: Sequence[SceneObject | PointCloud], links: Collection[str]) -> None:
    """Raise InvalidRequest for an object with the name of a link: messages name what is too near by these names."""
    for index, item in enumerate(items):
        if item.name in links:
            raise InvalidRequest(
                f"{item.name} is a link of the robot, and messages could not tell the two apart; choose another name",
                field=f"edit.objects.{index}.name",
            )


def _added(
    objects: dict[str, SceneObject], items: Sequence[SceneObject | PointCloud], replace: bool, meshes: Meshes
) -> dict[str, SceneObject]:
    added: dict[str, SceneObject] = {}
    for index, item in enumerate(items):
        field = f"edit.objects.{index}"
        if item.name in added:
            raise InvalidRequest(
                f"{item.name} appears twice in this edit; give each object one name", field=f"{field}.name"
            )
        if item.name in objects and not replace:
            raise InvalidRequest(
                f"there is already an object {item.name}; remove it first, set replace, or choose another name",
                field=f"{field}.name",
            )
        _check_size(item, field)
        added[item.name] = _kept(item, field, meshes)
    if len(objects | added) > MAX_OBJECTS:
        raise InvalidRequest(
            f"the scene would hold {len(objects | added)} objects, more than {MAX_OBJECTS}; remove some first",
            field="edit.objects",
        )
    parts = sum(_parts(item, meshes) for item in (objects | added).values())
    if parts > MAX_PARTS:
        raise InvalidRequest(
            f"the scene would consist of {parts} objects, cells and triangles, more than {MAX_PARTS}; use a coarser "
            "resolution or simpler meshes",
            field="edit.objects",
        )
    return objects | added


def _kept(item: SceneObject | PointCloud, field: str, meshes: Meshes) -> SceneObject:
    """The form of an object kept in the scene: occupied cells of a cloud, and a mesh with the digest of its file."""
    if isinstance(item, Mesh):
        return meshes.checked(item, field)
    if isinstance(item, Voxels):
        check_reach(cells_of(item).astype(np.float64) * item.resolution, f"{field}.cells")
    if not isinstance(item, PointCloud):
        return item
    return voxels_of(item, field)


def _parts(item: SceneObject, meshes: Meshes) -> int:
    if isinstance(item, Mesh):
        return meshes.count(item)
    return len(item.cells) if isinstance(item, Voxels) else 1


def _check_size(item: SceneObject | PointCloud, field: str) -> None:
    """Refuse sizes and positions that no robot meets and that distances cannot be computed with."""
    if not all(abs(x) <= _MAX_DISTANCE for x in item.position):
        raise InvalidRequest(
            f"{item.name} is further than {_MAX_DISTANCE:g} m away; positions are in m, in the base frame",
            field=f"{field}.position",
        )
    if isinstance(item, Cuboid):
        sizes = {f"size.{i}": edge for i, edge in enumerate(item.size)}
    elif isinstance(item, Sphere):
        sizes = {"radius": item.radius}
    elif isinstance(item, Mesh | Voxels | PointCloud):
        sizes = {}  # their extent is checked when they are converted to shapes
    else:
        sizes = {"radius": item.radius, "length": item.length}
    for name, size in sizes.items():
        if not _MIN_THICKNESS <= size <= _MAX_DISTANCE:
            raise InvalidRequest(
                f"{item.name}: {size:g} m is outside {_MIN_THICKNESS:g} to {_MAX_DISTANCE:g} m; sizes are in m",
                field=f"{field}.{name}",
            )
