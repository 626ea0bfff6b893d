"""What one message of MoveIt changes in the scene: collected, to be applied all or not at all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from moveit_msgs.msg import CollisionObject
from moveit_msgs.msg import MoveItErrorCodes as Val

from zarm_contract.messages import (
    VOXEL_MAP,
    AddObjects,
    Attached,
    AttachObject,
    ClearScene,
    DetachObject,
    EditBatch,
    RemoveObjects,
    Scene,
    SceneEdit,
    SceneObject,
    SetLinkCollision,
    SetObjectCollision,
    SetPairCollision,
    SingleEdit,
    Voxels,
)
from zarm_contract.robot import RobotDescription
from zarm_ros_bridge.convert.colours import Colour
from zarm_ros_bridge.convert.joints import known_as
from zarm_ros_bridge.frames import Frames, placed
from zarm_ros_bridge.moveit.allowances import Allowances
from zarm_ros_bridge.moveit.collision_objects import moved, name_of, origin_of, parts_of
from zarm_ros_bridge.moveit.error_codes import Refusal
from zarm_ros_bridge.moveit.octomap import OCTOMAP, OCTOMAP_NS
from zarm_ros_bridge.moveit.planning_scene import allowed_by, grouped
from zarm_trajectory.arrays import Array


class SceneDraft:
    """A scene with the changes so far; `origins` and `colours` are those of its collision objects by id."""

    def __init__(
        self,
        scene: Scene,
        robot: RobotDescription,
        frames: Frames,
        origins: Mapping[str, Array],
        colours: Mapping[str, Colour],
    ) -> None:
        self._scene, self._robot, self._frames = scene, robot, frames
        self.origins, self.colours = dict(origins), dict(colours)
        self._objects: dict[str, SceneObject] = {item.name: item for item in scene.objects}
        self._attached: dict[str, Attached] = {one.object.name: one for one in scene.attached}
        self._detached: set[str] = set()
        self._edits: list[SingleEdit] = []

    @property
    def edit(self) -> SceneEdit | None:
        """All changes as one edit; None if there is none."""
        if len(self._edits) < 2:
            return SceneEdit(edit=self._edits[0]) if self._edits else None
        return SceneEdit(edit=EditBatch(op="batch", edits=tuple(self._edits)))

    def clear(self) -> None:
        """Detach and remove everything but tools."""
        for name in [name for name, one in self._attached.items() if one.tool is None]:
            self._detach(name)
        self._remove_all()

    def change_object(self, message: Any) -> None:
        """Apply a CollisionObject. Raises Refusal and InvalidRequest."""
        if message.operation == CollisionObject.REMOVE:
            self._remove(message.id)
            return
        name = name_of(message.id)
        stamp = message.header.stamp
        frame = self._frames.pose_of(message.header.frame_id, stamp.sec + stamp.nanosec * 1e-9)
        known = grouped(self._objects.values()).get(name, [])
        if message.operation == CollisionObject.MOVE:
            self._move(message, name, frame, known)
            return
        parts = parts_of(message, name, frame, "collision_object")
        if message.operation == CollisionObject.APPEND and known:
            whole = [*known, *parts]
            parts = tuple(part.model_copy(update={"name": f"{name}..{i}"}) for i, part in enumerate(whole))
        elif message.operation not in (CollisionObject.ADD, CollisionObject.APPEND):
            raise Refusal(Val.INVALID_OBJECT_NAME, f"{message.operation} is no operation on an object", "operation")
        else:
            self.origins[name] = origin_of(message, frame, "collision_object")
        names = {part.name for part in parts}
        self._put(parts)
        self._take([part.name for part in known if part.name not in names])

    def change_attached(self, message: Any) -> None:
        """Apply an AttachedCollisionObject. Raises Refusal and InvalidRequest."""
        identity = message.object.id
        held = grouped(one.object for one in self._attached.values())
        if message.object.operation == CollisionObject.REMOVE:
            names = held if not identity else [name_of(identity)]
            for name in names:
                if name not in held:
                    raise Refusal(Val.INVALID_OBJECT_NAME, f"the robot carries no object {identity!r}", "object.id")
                for part in held[name]:
                    self._detach(part.name)
            return
        carrier = self._carrier(message.link_name)
        if message.object.primitives or message.object.meshes or message.object.planes:
            self.change_object(message.object)
        name = name_of(identity, "object.id")
        parts = grouped(self._objects.values()).get(name)
        if not parts:
            raise Refusal(
                Val.INVALID_OBJECT_NAME, f"there is no object {identity!r} in the scene to attach", "object.id"
            )
        links = self._robot.descriptor.collision
        touch = {known_as(link, links) for link in (message.link_name, *message.touch_links)}
        mass = message.weight / len(parts) if message.weight > 0.0 else None
        for part in parts:
            touched = tuple(link for link in links if link in touch)
            self._edits.append(AttachObject(op="attach", name=part.name, touch_links=touched, link=carrier, mass=mass))
            self._attached[part.name] = Attached(object=self._objects.pop(part.name), touch_links=touched, link=carrier)

    def replace_octomap(self, seen: Sequence[Voxels] = ()) -> None:
        """Put these objects in the place of the octomap that a client has sent."""
        names = {one.name for one in seen}
        gone = [part.name for part in grouped(self._objects.values()).get(OCTOMAP, ()) if part.name not in names]
        self._put(seen)
        self._take(gone)

    def allow(self, matrix: Any) -> None:
        """Ignore the collisions that an allowed collision matrix allows, and check the rest but for what the descriptor leaves out.

        Raises Refusal for a name that is neither a link nor an object.
        """
        links, descriptor = self._robot.descriptor.collision, self._robot.descriptor
        wanted, now = Allowances.of(matrix), Allowances.of(allowed_by(self._scene, descriptor))
        objects = grouped((*self._objects.values(), *(one.object for one in self._attached.values())))
        if OCTOMAP_NS in wanted.whole:
            raise Refusal(
                Val.FAILURE,
                "the octomap is not ignored as a whole; allow it to single links, or clear it",
                "allowed_collision_matrix",
            )
        self._check_names({*wanted.whole, *(name for pair in wanted.pairs for name in pair)}, objects)
        for ids, enabled in ((wanted.whole - now.whole, False), (now.whole - wanted.whole, True)):
            if touched := tuple(link for link in links if link in ids):
                self._edits.append(SetLinkCollision(op="links", names=touched, enabled=enabled))
            if names := tuple(part.name for identity in ids for part in objects.get(identity, ())):
                self._edits.append(SetObjectCollision(op="objects", names=names, enabled=enabled))
        left_out = {frozenset(pair) for pair in descriptor.self_collision_ignore}
        for pairs, enabled in ((wanted.pairs - now.pairs, False), (now.pairs - wanted.pairs, True)):
            single = tuple(
                (one, other)
                for pair in sorted(map(sorted, pairs - left_out))
                for one in self._checked(pair[0], objects)
                for other in self._checked(pair[1], objects)
                if not {one, other} <= {VOXEL_MAP, *self._objects}
            )
            if single:
                self._edits.append(SetPairCollision(op="pairs", names=single, enabled=enabled))

    def _check_names(self, ids: set[str], objects: Mapping[str, Sequence[SceneObject]]) -> None:
        if unknown := ids - {OCTOMAP_NS, *objects, *self._robot.urdf.links}:
            raise Refusal(
                Val.INVALID_OBJECT_NAME,
                f"{', '.join(sorted(unknown))} is neither a link nor an object",
                "allowed_collision_matrix",
            )

    def _checked(self, identity: str, objects: Mapping[str, Sequence[SceneObject]]) -> list[str]:
        """The link, or the parts of an object; none for a link without collision geometry."""
        if identity == OCTOMAP_NS:
            return [VOXEL_MAP, *(part.name for part in objects.get(OCTOMAP, ()))]
        if identity in objects:
            return [part.name for part in objects[identity]]
        return [identity] if identity in self._robot.descriptor.collision else []

    def _move(self, message: Any, name: str, frame: Array | None, known: Sequence[SceneObject]) -> None:
        if not known:
            raise Refusal(Val.INVALID_OBJECT_NAME, f"there is no object {message.id!r} to move", "id")
        if self._detached & {part.name for part in known}:
            raise Refusal(
                Val.INVALID_OBJECT_NAME, f"{message.id!r} is detached in the same message; move it in the next", "id"
            )
        before = self.origins.get(name, placed(known[0]))
        now = origin_of(message, frame, "collision_object")
        self._put([moved(part, now @ np.linalg.inv(before)) for part in known])
        self.origins[name] = now

    def _remove(self, identity: str) -> None:
        """Remove an object, or with an empty id all, as MoveIt does."""
        if not identity:
            self._remove_all()
            return
        name = name_of(identity)
        parts = grouped(self._objects.values()).get(name)
        if not parts:
            raise Refusal(Val.INVALID_OBJECT_NAME, f"there is no object {identity!r} to remove", "id")
        self._take([part.name for part in parts])
        self.origins.pop(name, None)
        self.colours.pop(name, None)

    def _remove_all(self) -> None:
        self._edits.append(ClearScene(op="clear"))
        self._objects.clear()
        self.origins.clear()

    def _put(self, parts: Sequence[SceneObject]) -> None:
        """Add objects, or put them in the place of those of the same names."""
        if not parts:
            return
        last = self._edits[-1] if self._edits else None
        if isinstance(last, AddObjects) and not {part.name for part in parts} & {one.name for one in last.objects}:
            self._edits[-1] = last.model_copy(update={"objects": (*last.objects, *parts)})
        else:
            self._edits.append(AddObjects(op="add", objects=tuple(parts), replace=True))
        self._objects.update({part.name: part for part in parts})

    def _take(self, names: Sequence[str]) -> None:
        """Remove objects."""
        if not names:
            return
        last = self._edits[-1] if self._edits else None
        if isinstance(last, RemoveObjects):
            self._edits[-1] = last.model_copy(update={"names": (*last.names, *names)})
        else:
            self._edits.append(RemoveObjects(op="remove", names=tuple(names)))
        for name in names:
            del self._objects[name]

    def _detach(self, name: str) -> None:
        self._edits.append(DetachObject(op="detach", name=name))
        self._objects[name] = self._attached.pop(name).object
        self._detached.add(name)

    def _carrier(self, name: str) -> str | None:
        """The link that an object is attached to; None for one that is fixed to the tip. Raises Refusal for none of the robot's."""
        links, tip = self._frames.links, self._robot.descriptor.tip_link
        link = known_as(name, links.links) or tip
        if link not in links.links:
            raise Refusal(
                Val.INVALID_LINK_NAME,
                f"the robot has no link {name!r}; choose among {', '.join(links.links)}",
                "link_name",
            )
        return None if links.rigid(link) == links.rigid(tip) else link
