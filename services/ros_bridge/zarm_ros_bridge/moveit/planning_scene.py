"""The scene as MoveIt's planning scene."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from moveit_msgs.msg import (
    AllowedCollisionEntry,
    AllowedCollisionMatrix,
    AttachedCollisionObject,
    LinkPadding,
    LinkScale,
    ObjectColor,
    PlanningScene,
    PlanningSceneComponents,
)
from std_msgs.msg import ColorRGBA

from zarm_contract.descriptor import RobotDescriptor
from zarm_contract.messages import VOXEL_MAP, Scene, SceneObject, Voxels
from zarm_contract.robot import RobotDescription
from zarm_geometry.frames import matrix
from zarm_geometry.voxel_blocks import VoxelBlocks
from zarm_ros_bridge.convert.colours import Colour
from zarm_ros_bridge.frames import placed
from zarm_ros_bridge.moveit.collision_objects import collision_object, id_of
from zarm_ros_bridge.moveit.octomap import OCTOMAP, OCTOMAP_NS, octomap
from zarm_ros_bridge.moveit.states import Positions, robot_state
from zarm_trajectory.arrays import Array

C = PlanningSceneComponents
ALL = 1023
"""Every component of a planning scene."""
_UPRIGHT = (0.0, 0.0, 0.0, 1.0)


def grouped(objects: Iterable[SceneObject]) -> dict[str, list[SceneObject]]:
    """The objects of the scene by the id of their collision object."""
    found: dict[str, list[SceneObject]] = {}
    for item in objects:
        found.setdefault(id_of(item.name), []).append(item)
    return found


def allowed_by(scene: Scene, descriptor: RobotDescriptor) -> Any:
    """The allowed collision matrix: the pairs of links that the descriptor leaves out, and what the scene ignores."""
    links = list(descriptor.collision)
    pairs = {frozenset(pair) for pair in descriptor.self_collision_ignore}
    pairs |= {frozenset(map(_id_in_matrix, pair)) for pair in scene.ignored_pairs}
    objects = dict.fromkeys(id_of(name) for name in scene.ignored_objects)
    paired = dict.fromkeys(_id_in_matrix(name) for pair in scene.ignored_pairs for name in pair)
    names = [*links, *(name for name in {**objects, **paired} if name not in links)]
    whole = {*scene.ignored_links, *objects}
    rows = [
        [
            (a == b and a in whole) or (a != b and (frozenset((a, b)) in pairs or a in whole or b in whole))
            for b in names
        ]
        for a in names
    ]
    defaults = sorted(whole)
    return AllowedCollisionMatrix(
        entry_names=names,
        entry_values=[AllowedCollisionEntry(enabled=row) for row in rows],
        default_entry_names=defaults,
        default_entry_values=[True] * len(defaults),
    )


def _id_in_matrix(name: str) -> str:
    """What MoveIt calls a link or an object there."""
    identity = id_of(name)
    return OCTOMAP_NS if identity in (OCTOMAP, VOXEL_MAP) else identity


class PlanningSceneMessages:
    """Makes the messages. `origins` are the poses (4, 4) that clients gave collision objects, by id, and `voxels` the blocks of the voxel map."""

    def __init__(
        self,
        robot: RobotDescription,
        origins: Mapping[str, Array],
        colours: Mapping[str, Colour],
        voxels: VoxelBlocks,
    ) -> None:
        self._robot = robot
        self._voxels = voxels
        self._origins = origins
        self._colours = colours

    def message(self, scene: Scene, joints: Positions | None, components: int = ALL) -> Any:
        """The whole scene, or these components of it; without `joints` the state of the robot is left out."""
        descriptor = self._robot.descriptor
        message = PlanningScene(name=scene.revision, robot_model_name=descriptor.name)
        message.is_diff = False
        taken = _octomap_of(scene.objects)
        shows_map = bool(taken) and not self._voxels.objects
        blocks = taken if shows_map else tuple(self._voxels.objects.values())
        if components & (C.ROBOT_STATE | C.ROBOT_STATE_ATTACHED_OBJECTS) and joints is not None:
            message.robot_state = robot_state(descriptor.joints, joints)
        if components & C.ROBOT_STATE_ATTACHED_OBJECTS:
            message.robot_state.attached_collision_objects = self._attached(scene)
        if components & (C.WORLD_OBJECT_NAMES | C.WORLD_OBJECT_GEOMETRY):
            message.world.collision_objects = [
                self._object(identity, parts, geometry=bool(components & C.WORLD_OBJECT_GEOMETRY))
                for identity, parts in grouped(scene.objects).items()
                if not (shows_map and identity == OCTOMAP)
            ]
        if components & C.OCTOMAP:
            message.world.octomap = octomap(blocks, descriptor.base_link)
        if components & C.ALLOWED_COLLISION_MATRIX:
            message.allowed_collision_matrix = allowed_by(scene, descriptor)
        if components & C.LINK_PADDING_AND_SCALING:
            message.link_padding = [LinkPadding(link_name=link) for link in descriptor.collision]
            message.link_scale = [LinkScale(link_name=link, scale=1.0) for link in descriptor.collision]
        if components & C.OBJECT_COLORS:
            message.object_colors = [
                ObjectColor(id=name, color=ColorRGBA(r=r, g=g, b=b, a=a))
                for name, (r, g, b, a) in self._colours.items()
            ]
        return message

    def seen(self) -> Any:
        """What has changed if only the voxel map has."""
        message = PlanningScene(robot_model_name=self._robot.descriptor.name, is_diff=True)
        message.robot_state.is_diff = True
        message.world.octomap = octomap(self._voxels.objects.values(), self._robot.descriptor.base_link)
        return message

    def _object(self, identity: str, parts: list[SceneObject], *, geometry: bool) -> Any:
        base = self._robot.descriptor.base_link
        origin = self._origins.get(identity)
        if origin is None:
            origin = placed(parts[0]) if len(parts) == 1 else np.eye(4)
        return collision_object(identity, parts if geometry else [], origin, base)

    def _attached(self, scene: Scene) -> list[Any]:
        tip = self._robot.descriptor.tip_link
        found = grouped(one.object for one in scene.attached)
        touch = {id_of(one.object.name): one.touch_links for one in scene.attached}
        carrier = {id_of(one.object.name): one.link or tip for one in scene.attached}
        return [
            AttachedCollisionObject(
                link_name=carrier[identity],
                object=collision_object(
                    identity,
                    parts,
                    placed(parts[0]) if len(parts) == 1 else matrix((0.0, 0.0, 0.0)),
                    carrier[identity],
                ),
                touch_links=list(touch[identity]),
                weight=sum(one.mass or 0.0 for one in scene.attached if id_of(one.object.name) == identity),
            )
            for identity, parts in found.items()
        ]


def _octomap_of(objects: Iterable[SceneObject]) -> tuple[Voxels, ...]:
    """The objects that are a client's octomap, if they can be shown as one."""
    parts = grouped(objects).get(OCTOMAP, [])
    found = tuple(part for part in parts if isinstance(part, Voxels) and part.orientation == _UPRIGHT)
    same = {(part.resolution, part.position) for part in found}
    return found if len(found) == len(parts) and len(same) == 1 else ()
