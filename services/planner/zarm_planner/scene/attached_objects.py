"""Attached objects of the scene, and edits of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import (
    MAX_ATTACHED,
    MAX_ATTACHED_PARTS,
    MAX_OBJECTS,
    Attached,
    AttachObject,
    Cuboid,
    DetachObject,
    Mesh,
    Scene,
    SceneObject,
    Sphere,
    Voxels,
)
from zarm_geometry.frames import matrix, pose_of
from zarm_geometry.meshes import Meshes
from zarm_geometry.robot_model import RobotModel
from zarm_trajectory.arrays import Array


def attach(scene: Scene, edit: AttachObject, tip: Array, meshes: Meshes) -> Scene:
    """The scene with an object attached to its link, whose pose is `tip` (4, 4). Raises InvalidRequest.

    Raises Unavailable for a mesh whose file is missing.
    """
    objects = {item.name: item for item in scene.objects}
    if any(edit.name == one.object.name for one in scene.attached):
        raise InvalidRequest(f"the robot carries {edit.name} already; detach it first", field="edit.name")
    if edit.name not in objects:
        raise InvalidRequest(
            f"there is no object {edit.name} in the scene; add it first, where it stands", field="edit.name"
        )
    if len(scene.attached) == MAX_ATTACHED:
        raise InvalidRequest(f"the robot carries {MAX_ATTACHED} objects already; detach one first", field="edit.name")
    item = objects.pop(edit.name)
    held = _moved(item, np.asarray(np.linalg.inv(tip), np.float64))
    parts = _parts(held, meshes) if isinstance(held, Mesh | Voxels) else ()
    attached = Attached(
        object=held, touch_links=edit.touch_links, parts=parts, link=edit.link, mass=edit.mass, center=edit.center
    )
    return scene.model_copy(update={"objects": tuple(objects.values()), "attached": (*scene.attached, attached)})


def detach(scene: Scene, edit: DetachObject, tip: Array) -> Scene:
    """The scene with an attached object detached at its place where its link is at `tip` (4, 4). Raises InvalidRequest."""
    attached = {one.object.name: one for one in scene.attached}
    if edit.name not in attached:
        raise InvalidRequest(
            f"the robot does not carry {edit.name}; it carries {', '.join(attached) or 'nothing'}", field="edit.name"
        )
    if len(scene.objects) == MAX_OBJECTS:
        raise InvalidRequest(f"the scene holds {MAX_OBJECTS} objects already; remove some first", field="edit.name")
    item = _moved(attached.pop(edit.name).object, tip)
    return scene.model_copy(update={"objects": (*scene.objects, item), "attached": tuple(attached.values())})


def carrier(model: RobotModel, scene: Scene, edit: AttachObject | DetachObject) -> str:
    """The link to which an object is attached, or is to be. Raises InvalidRequest for one that is not of the robot."""
    link = edit.link if isinstance(edit, AttachObject) else _attached_to(scene, edit.name)
    if link is None:
        return model.robot.descriptor.tip_link
    if link not in model.robot.urdf.links:
        links = ", ".join(model.robot.urdf.links)
        raise InvalidRequest(f"{link} is not a link of the robot; those are {links}", field="edit.link")
    try:
        model.mount(link)
    except InvalidRequest as error:
        raise InvalidRequest(
            f"{error.problem.message}; attach to the link that carries it", field="edit.link"
        ) from error
    return link


def _attached_to(scene: Scene, name: str) -> str | None:
    return next((one.link for one in scene.attached if one.object.name == name), None)


def check_attach(links: tuple[str, ...], name: str, touch_links: tuple[str, ...], field: str) -> None:
    """Raises InvalidRequest for links that the robot lacks, and for an object that is called like one of its `links`."""
    check_links(links, touch_links, f"{field}.touch_links")
    if name in links:
        raise InvalidRequest(f"{name} is a link of the robot; add the object under another name", field=f"{field}.name")


def check_links(links: tuple[str, ...], names: tuple[str, ...], field: str) -> None:
    """Raises InvalidRequest for a name that is none of the `links` with collision geometry."""
    for i, name in enumerate(names):
        if name not in links:
            raise InvalidRequest(
                f"{name} is not a link with collision geometry; those are {', '.join(links)}", field=f"{field}.{i}"
            )


def refuse_attached(scene: Scene, names: Sequence[str], field: str) -> None:
    """Raises InvalidRequest if one of `names` is that of an attached object; its index goes into `field`."""
    attached = {one.object.name for one in scene.attached}
    for index, name in enumerate(names):
        if name in attached:
            raise InvalidRequest(f"the robot carries {name}; detach it first", field=field.format(index))


def _parts(item: Mesh | Voxels, meshes: Meshes) -> tuple[Cuboid, ...]:
    """Cuboids that enclose an object, in the frame of its pose."""
    lower, upper = meshes.around(item, MAX_ATTACHED_PARTS)
    pose = matrix(item.position, item.orientation)
    centers = ((lower + upper) / 2) @ pose[:3, :3].T + pose[:3, 3]
    return tuple(
        Cuboid(kind="cuboid", name=item.name, position=center, orientation=item.orientation, size=size)
        for center, size in zip(map(tuple, centers.tolist()), map(tuple, (upper - lower).tolist()), strict=True)
    )


def _moved(item: SceneObject, frame: Array) -> SceneObject:
    """An object, its pose given in `frame` (4, 4), with its pose in the frame that `frame` is given in."""
    if isinstance(item, Sphere):
        return item.model_copy(update={"position": pose_of(frame @ matrix(item.position)).position})
    pose = pose_of(frame @ matrix(item.position, item.orientation))
    return item.model_copy(update={"position": pose.position, "orientation": pose.orientation})
