"""The planning scene: its services and topics, both ways."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, MutableMapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from moveit_msgs.msg import (
    AttachedCollisionObject,
    CollisionObject,
    PlanningScene,
)
from moveit_msgs.msg import MoveItErrorCodes as Val
from moveit_msgs.srv import ApplyPlanningScene, GetPlanningScene, LoadGeometryFromFile, SaveGeometryToFile
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.qos import QoSProfile
from std_srvs.srv import Empty

from zarm_contract.errors import InternalError, ZarmError
from zarm_contract.messages import Scene, Voxels
from zarm_geometry.voxel_blocks import VoxelBlocks
from zarm_ros_bridge.convert.colours import Colour
from zarm_ros_bridge.convert.fields import finite
from zarm_ros_bridge.convert.joints import known_as
from zarm_ros_bridge.engine import Engine
from zarm_ros_bridge.frames import Frames
from zarm_ros_bridge.moveit.collision_objects import id_of, name_of
from zarm_ros_bridge.moveit.error_codes import Refusal
from zarm_ros_bridge.moveit.monitored_scene import MonitoredScene
from zarm_ros_bridge.moveit.octomap import OCTOMAP, voxels_of
from zarm_ros_bridge.moveit.planning_scene import ALL, PlanningSceneMessages
from zarm_ros_bridge.moveit.scene_draft import SceneDraft
from zarm_ros_bridge.moveit.scene_text import objects_of, text_of
from zarm_ros_bridge.ros import Ros
from zarm_trajectory.arrays import Array

log = logging.getLogger(__name__)

EDITS = QoSProfile(depth=100)


class PlanningScenes:
    """Edits the scene, and shows it. Use it in `with`."""

    def __init__(self, ros: Ros, engine: Engine, frames: Frames, colours: MutableMapping[str, Colour]) -> None:
        self._engine = engine
        self._frames = frames
        self._colours = colours
        self._origins: dict[str, Array] = {}
        self._voxels = VoxelBlocks()
        self._messages = PlanningSceneMessages(engine.robot, self._origins, colours, self._voxels)
        self._editing = threading.Lock()
        self._log = ros.node.get_logger()
        self._monitored = MonitoredScene(ros, self._messages, self._voxels, self._joints)
        ros.serve(GetPlanningScene, "get_planning_scene", self._get)
        ros.serve(ApplyPlanningScene, "apply_planning_scene", self._apply)
        ros.serve(SaveGeometryToFile, "save_geometry_to_file", self._save)
        ros.serve(LoadGeometryFromFile, "load_geometry_from_file", self._load)
        ros.serve(Empty, "clear_octomap", self._clear_map)
        in_order = MutuallyExclusiveCallbackGroup()
        for kind, topic, edit in (
            (CollisionObject, "collision_object", self._object),
            (AttachedCollisionObject, "attached_collision_object", self._attachment),
            (PlanningScene, "planning_scene", self._edit),
        ):
            ros.node.create_subscription(kind, topic, self._listened(topic, edit), EDITS, callback_group=in_order)

    def __enter__(self) -> Self:
        self._monitored.start()
        self._engine.bus.watch(self._engine.keys.scene, self._on_scene)
        self._engine.bus.watch(self._engine.keys.voxels("*"), self._voxels.receive)
        self._engine.bus.watch(self._engine.keys.perception_state, self._voxels.on_state)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._monitored.stop()

    def check_diff(self, scene: Any) -> None:
        """Raises Refusal for a scene that is to hold for one plan alone."""
        world, state = scene.world, scene.robot_state
        if world.collision_objects or state.attached_collision_objects or scene.allowed_collision_matrix.entry_names:
            raise Refusal(
                Val.INVALID_OBJECT_NAME,
                "a plan is made in the scene that all see; apply the changes with apply_planning_scene first",
                "planning_options.planning_scene_diff",
            )

    # -- services and topics --

    def _get(self, request: Any, response: Any) -> Any:
        try:
            scene = self._engine.client.scene.read()
            components = request.components.components or ALL
            response.scene = self._messages.message(scene, self._joints(), components)
        except ZarmError as error:
            self._log.warning(f"get_planning_scene: {error}")
        except Exception:  # one request fails and the service continues; in rclpy it would end the thread
            log.exception("get_planning_scene failed")
        return response

    def _apply(self, request: Any, response: Any) -> Any:
        response.success = self._done("apply_planning_scene", self._edit, request.scene)
        return response

    def _save(self, request: Any, response: Any) -> Any:
        response.success = self._done("save_geometry_to_file", self._write, request.file_path_and_name)
        return response

    def _load(self, request: Any, response: Any) -> Any:
        response.success = self._done("load_geometry_from_file", self._read, request.file_path_and_name)
        return response

    def _clear_map(self, _: Any, response: Any) -> Any:
        self._done("clear_octomap", self._forget_map, None)
        return response

    def _forget_map(self, _: Any) -> None:
        """Forget the octomap that a client has sent, and what cameras have seen. Raises Unavailable where that cannot be done."""
        draft = self._draft()
        draft.replace_octomap()
        self._apply_draft(draft)
        if self._voxels.objects:
            self._engine.client.perception.clear()

    def _listened(self, topic: str, edit: Callable[[Any], None]) -> Callable[[Any], None]:
        def received(message: Any) -> None:
            self._done(topic, edit, message)

        return received

    def _done(self, name: str, edit: Callable[[Any], None], message: Any) -> bool:
        """Whether an edit was applied; the log on ROS has the reason if not."""
        try:
            with self._editing:
                edit(message)
        except ZarmError as error:
            self._log.error(f"{name}: {error}")
            return False
        except Exception:  # likewise
            log.exception("edit failed name=%s", name)
            self._log.error(f"{name}: {InternalError('the ROS bridge failed on this edit; its log has the trace')}")
            return False
        return True

    # -- edits --

    def _edit(self, message: Any) -> None:
        """A whole scene, or with `is_diff` what changes. Raises Refusal, and the planner's errors."""
        margin = self._margin(message.link_padding)
        for i, scale in enumerate(message.link_scale):
            if scale.scale != 1.0:
                raise Refusal(Val.FAILURE, "links are not scaled; leave it at 1", f"link_scale[{i}].scale")
        seen = self._mapped(message.world.octomap)
        draft = self._draft()
        if not message.is_diff:
            draft.clear()
        if seen is not None:
            draft.replace_octomap(seen)
        for attached in message.robot_state.attached_collision_objects:
            if attached.object.operation == CollisionObject.REMOVE:
                draft.change_attached(attached)
        for item in message.world.collision_objects:
            draft.change_object(item)
        for attached in message.robot_state.attached_collision_objects:
            if attached.object.operation != CollisionObject.REMOVE:
                draft.change_attached(attached)
        if message.allowed_collision_matrix.entry_names or message.allowed_collision_matrix.default_entry_names:
            draft.allow(message.allowed_collision_matrix)
        for colour in message.object_colors:
            c = colour.color
            draft.colours[name_of(colour.id)] = (c.r, c.g, c.b, c.a)
        planner = self._engine.client.planner
        if margin is None:
            self._apply_draft(draft)
            return
        before = planner.settings().margin
        planner.settings(margin=margin)
        try:
            self._apply_draft(draft)
        except ZarmError:
            planner.settings(margin=before)
            raise

    def _object(self, message: Any) -> None:
        draft = self._draft()
        draft.change_object(message)
        self._apply_draft(draft)

    def _attachment(self, message: Any) -> None:
        draft = self._draft()
        draft.change_attached(message)
        self._apply_draft(draft)

    def _draft(self) -> SceneDraft:
        """What is to change in the present scene."""
        engine = self._engine
        return SceneDraft(engine.client.scene.read(), engine.robot, self._frames, self._origins, self._colours)

    def _apply_draft(self, draft: SceneDraft) -> None:
        """Apply all changes of a draft, or none. Raises the planner's errors."""
        if (edit := draft.edit) is not None:
            self._engine.client.scene.apply(edit)
        self._origins |= draft.origins
        for gone in {*self._origins} - {*draft.origins}:
            self._origins.pop(gone, None)
        self._colours.update(draft.colours)
        for gone in {*self._colours} - {*draft.colours}:
            self._colours.pop(gone, None)

    def _margin(self, padding: Sequence[Any]) -> float | None:
        """The margin (m) to objects that a padding of all links asks for; None for none. Raises Refusal for links that differ."""
        padded = {known_as(one.link_name, self._engine.robot.descriptor.collision): one.padding for one in padding}
        if not any(padded.values()):
            return None
        if len({*padded.values()}) > 1 or {*self._engine.robot.descriptor.collision} - {*padded}:
            raise Refusal(
                Val.FAILURE,
                "zarm keeps one margin to all objects; give all links with collision geometry the same padding",
                "link_padding",
            )
        return finite(next(iter(padded.values())), "link_padding[0].padding")

    def _mapped(self, message: Any) -> tuple[Voxels, ...] | None:
        """The objects of an octomap; None if there is none, or cameras make the map. Raises Refusal and InvalidRequest."""
        if not message.octomap.id:
            return None
        if self._voxels.objects:
            self._log.info("an octomap is not taken while cameras make the voxel map")
            return None
        header = message.header
        frame = self._frames.pose_of(header.frame_id, header.stamp.sec + header.stamp.nanosec * 1e-9)
        return voxels_of(message, frame, OCTOMAP)

    def _write(self, name: str) -> None:
        """Save the objects to a file of this machine."""
        scene = self._engine.client.scene.read()
        items = self._messages.message(scene, None).world.collision_objects
        path = _file(name)
        try:
            path.write_text(text_of(scene.revision, items, dict(self._colours)))
        except OSError as error:
            raise Refusal(Val.FAILURE, f"{path} cannot be written: {error.strerror}", "file_path_and_name") from error

    def _read(self, name: str) -> None:
        """Add the objects of a file of this machine."""
        path = _file(name)
        try:
            text = path.read_text()
        except (OSError, UnicodeDecodeError) as error:
            raise Refusal(Val.FAILURE, f"{path} cannot be read: {error}", "file_path_and_name") from error
        draft = self._draft()
        for item in objects_of(text, self._frames.links.base):
            draft.change_object(item)
        self._apply_draft(draft)

    # -- what is published --

    def _on_scene(self, _: str, scene: Scene) -> None:
        names = {id_of(item.name) for item in scene.objects} | {id_of(one.object.name) for one in scene.attached}
        for gone in set(self._origins) - names:
            self._origins.pop(gone, None)
        self._monitored.change(scene)

    def _joints(self) -> tuple[float, ...] | None:
        try:
            return self._frames.joints()
        except ZarmError:
            return None


def _file(name: str) -> Path:
    """A file that a client may name. Raises Refusal for any other kind of file."""
    path = Path(name)
    if path.suffix != ".scene":
        raise Refusal(
            Val.FAILURE, f"{name!r} is no file of a scene; give one that ends with .scene", "file_path_and_name"
        )
    return path
