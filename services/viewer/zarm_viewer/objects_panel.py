"""Objects of the scene: add, drag and turn, resize, remove, attach, detach, load, save."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from viser import (
    GuiButtonHandle,
    GuiEvent,
    GuiUploadButtonHandle,
    Icon,
    SceneClickEvent,
    TransformControlsEvent,
    TransformControlsHandle,
)
from viser.transforms import SE3

from zarm.objects import Capsule, Cuboid, Cylinder, Sphere
from zarm_contract import messages
from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import Scene, SceneObject
from zarm_viewer.controls import button, put
from zarm_viewer.kinematics import message_of, pose_at, pose_of
from zarm_viewer.panel_context import PanelContext
from zarm_viewer.scene_view import SceneView

KINDS = ("cuboid", "sphere", "cylinder", "capsule")
_NOTHING = "-"


class ObjectsPanel:
    """The objects by name; the one chosen, by its name or by a click in the 3D view, has a gizmo."""

    def __init__(self, panels: PanelContext, view: SceneView) -> None:
        self._panels, self._view = panels, view
        self._scene: Scene | None = None
        self._gizmo: TransformControlsHandle | None = None
        self._added = ""
        self._chosen: SceneObject | None = None
        gui = panels.server.gui
        self._choice = gui.add_dropdown("object", [_NOTHING])
        self._choice.on_update(lambda _: self._choose())
        self._size = gui.add_vector3("size (m)", (0.1, 0.1, 0.1), min=(0.001,) * 3, step=0.01, hint=_SIZES)
        button(self._panels, "Resize", Icon.RESIZE, self._resize)
        button(self._panels, "Remove", Icon.TRASH, lambda: panels.robot.scene.remove(self._name()))
        button(self._panels, "Attach to the tip", Icon.MAGNET, lambda: panels.robot.scene.attach(self._name()))
        button(self._panels, "Detach", Icon.MAGNET_OFF, lambda: panels.robot.scene.detach(self._name()))
        with gui.add_folder("Add"):
            self._kind = gui.add_dropdown("kind", KINDS)
            self._new_name = gui.add_text("name", "box")
            self._new_size = gui.add_vector3("size (m)", (0.15, 0.15, 0.15), min=(0.001,) * 3, step=0.01, hint=_SIZES)
            self._new_place = gui.add_vector3("place (m)", (0.5, 0.4, 0.2), step=0.01)
            button(self._panels, "Add", Icon.PLUS, self._add)
        with gui.add_folder("File", expand_by_default=False):
            upload = gui.add_upload_button("Load", icon=Icon.UPLOAD, mime_type=".yaml,.yml")

            @upload.on_upload
            def _(event: GuiEvent[GuiUploadButtonHandle]) -> None:
                panels.attempt("load", lambda: self._load(upload.value.name, upload.value.content), event.client)

            save = gui.add_button("Save", icon=Icon.DOWNLOAD)

            @save.on_click
            def _(event: GuiEvent[GuiButtonHandle]) -> None:
                panels.attempt("save", lambda: self._save(event.client), event.client)

        panels.server.scene.on_click()(self._click)

    def draw(self, scene: Scene | None) -> None:
        """Show the objects of a new scene."""
        if scene is None:
            return
        self._scene = scene
        names = [item.name for item in scene.objects] + [carried.object.name for carried in scene.attached]
        options = [_NOTHING, *names]
        if list(self._choice.options) != options:
            self._choice.options = options
        if self._added in names:
            put(self._choice, self._added)
            self._added = ""
        self._choose()

    def _click(self, event: SceneClickEvent) -> None:
        base = np.array((0.0, self._panels.aside, 0.0))
        name = self._view.hit(np.array(event.ray_origin) - base, np.array(event.ray_direction))
        if name in self._choice.options:
            put(self._choice, name)

    def _object(self) -> SceneObject | None:
        objects = self._scene.objects if self._scene else ()
        return next((item for item in objects if item.name == self._choice.value), None)

    def _name(self) -> str:
        if self._choice.value == _NOTHING:
            raise InvalidRequest("no object is selected; select one by name, or click it")
        return self._choice.value

    def _choose(self) -> None:
        """Move the gizmo to the chosen object; attached objects have none, because they move with the robot."""
        item = self._object()
        if item is None:
            if self._gizmo is not None:
                self._gizmo.remove()
                self._gizmo = None
            return
        at = _pose(item)
        if item != self._chosen:
            put(self._size, _size(item))
        self._chosen = item
        if self._gizmo is None:
            self._gizmo = self._panels.server.scene.add_transform_controls(
                f"{self._panels.root}/object", scale=0.2, depth_test=False
            )
            self._gizmo.on_update(self._drag)
        self._gizmo.position, self._gizmo.wxyz = at.translation(), at.rotation().wxyz

    def _drag(self, event: TransformControlsEvent) -> None:
        item = self._object()
        if item is None:
            return
        at = pose_at(event.target)
        if event.phase == "end":
            self._panels.attempt(f"move {item.name}", lambda: self._replace(_placed(item, at)), event.client)
        else:
            self._view.place(item.name, at)

    def _resize(self) -> None:
        if (item := self._object()) is None:
            raise InvalidRequest(
                "attached objects cannot be resized; detach it first, or select an object in the scene"
            )
        self._replace(_resized(item, self._size.value))

    def _replace(self, item: SceneObject) -> None:
        self._panels.robot.scene.add(item, replace=True)

    def _add(self) -> None:
        at = SE3.from_translation(np.array(self._new_place.value))
        self._added = self._new_name.value
        self._panels.robot.scene.add(_made(self._kind.value, self._new_name.value, self._new_size.value, at))
        self._panels.note(f"added {self._new_name.value}")

    def _load(self, name: str, content: bytes) -> None:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder, Path(name).name)
            file.write_bytes(content)
            self._panels.robot.scene.load(file)

    def _save(self, client: Any) -> None:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder, "scene.yaml")
            self._panels.robot.scene.save(file)
            client.send_file_download("scene.yaml", file.read_bytes(), save_immediately=True)


_SIZES = "cuboid: edges; sphere: radius first; cylinder and capsule: radius, -, length; mesh: scale"


def _made(kind: str, name: str, size: tuple[float, float, float], at: SE3) -> SceneObject:
    """An object of one of `KINDS`, sized as in `_SIZES`. Raises InvalidRequest."""
    pose = message_of(at)
    match kind:
        case "cuboid":
            return Cuboid(name, size=size, position=pose.position, orientation=pose.orientation)
        case "sphere":
            return Sphere(name, radius=size[0], position=pose.position)
        case "cylinder":
            return Cylinder(name, radius=size[0], length=size[2], position=pose.position, orientation=pose.orientation)
        case _:
            return Capsule(name, radius=size[0], length=size[2], position=pose.position, orientation=pose.orientation)


def _resized(item: SceneObject, size: tuple[float, float, float]) -> SceneObject:
    """The object in another size, as in `_SIZES`. Raises InvalidRequest for voxels."""
    match item.kind:
        case "cuboid":
            return item.model_copy(update={"size": size})
        case "mesh":
            return item.model_copy(update={"scale": size})
        case "voxels":
            raise InvalidRequest(
                "voxels cannot be resized; remove them, and add new ones with another resolution", field="size"
            )
        case _:
            return item.model_copy(update={"radius": size[0]} | ({"length": size[2]} if item.kind != "sphere" else {}))


def _size(item: SceneObject) -> tuple[float, float, float]:
    """The size of an object, as in `_SIZES`; for voxels, that of one voxel."""
    match item:
        case messages.Cuboid():
            return item.size
        case messages.Mesh():
            return item.scale
        case messages.Voxels():
            return (item.resolution,) * 3
        case messages.Sphere():
            return (item.radius,) * 3
        case _:
            return item.radius, item.radius, item.length


def _pose(item: SceneObject) -> SE3:
    return pose_of(item.position, getattr(item, "orientation", (0.0, 0.0, 0.0, 1.0)))


def _placed(item: SceneObject, at: SE3) -> SceneObject:
    """The object at another pose."""
    pose = message_of(at)
    update: dict[str, object] = {"position": pose.position}
    if item.kind != "sphere":
        update["orientation"] = pose.orientation
    return item.model_copy(update=update)
