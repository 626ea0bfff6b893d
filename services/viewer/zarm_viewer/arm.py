"""A robot in the picture: as measured, as a ghost, or where a goal would bring it."""

from __future__ import annotations

import logging
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import viser
from viser import MeshHandle, SceneNodeHandle
from viser.transforms import SE3, SO3

from zarm_contract.robot import RobotDescription
from zarm_viewer.drawing import Brush, Colour, file_mesh, link_mesh
from zarm_viewer.kinematics import Array, motion, origin

log = logging.getLogger(__name__)

SPHERES = (250, 176, 5)
_FORMATS = (".stl", ".obj", ".dae")
STILL = 1e-4
"""A joint that has moved less (rad or m) is not drawn anew."""


@dataclass(frozen=True)
class _Visual:
    """A mesh for the eyes, in the frame of its link."""

    file: Path
    scale: tuple[float, float, float]
    at: SE3


class Arm:
    """One drawing of a robot under the node `root`; the browser places each link in its parent, so that only joints are sent.

    Links look like their visual meshes where the URDF names STL, OBJ or COLLADA files that are there, else like their exact geometry.
    """

    def __init__(self, api: viser.SceneApi, root: str, robot: RobotDescription, colour: Colour, opacity: float) -> None:
        self._frame = api.add_frame(root, show_axes=False)
        self._shapes: list[MeshHandle] = []
        self._at: Array | None = None
        brush = Brush(api, colour, opacity)
        joints = {joint.child: joint for joint in robot.urdf.joint_of_child.values()}
        names = {robot.descriptor.base_link: root}
        waiting = list(joints.values())
        moving: dict[str, tuple[SceneNodeHandle, int]] = {}
        while ready := [joint for joint in waiting if joint.parent in names]:
            for joint in ready:
                waiting.remove(joint)
                names[joint.child] = f"{names[joint.parent]}/{joint.child}"
                at = origin(joint)
                frame = api.add_frame(
                    names[joint.child], show_axes=False, wxyz=at.rotation().wxyz, position=at.translation()
                )
                if joint.name in robot.descriptor.joints:
                    moving[joint.child] = frame, robot.descriptor.joints.index(joint.name)
        self._moving = [(frame, index, joints[link], origin(joints[link])) for link, (frame, index) in moving.items()]
        self.tip = names[robot.descriptor.tip_link]
        self.nodes = names  # of each link in the scene
        self._api, self._robot = api, robot
        self._spheres: list[MeshHandle] = []
        self._axes: list[SceneNodeHandle] = []
        visuals = _visuals(robot.urdf_path)
        for link, node in names.items():
            self._draw_link(brush, node, robot, link, visuals.get(link, ()))
        self.move(np.array(robot.descriptor.home))

    def _draw_link(
        self, brush: Brush, node: str, robot: RobotDescription, link: str, visuals: tuple[_Visual, ...]
    ) -> None:
        try:
            meshes = [(file_mesh(visual.file, visual.scale), visual.at) for visual in visuals]
        except (ValueError, OSError) as error:
            log.warning("visual mesh not drawn link=%s reason=%s", link, error)
            meshes = []
        for index, (mesh, at) in enumerate(meshes):
            self._shapes.append(brush.mesh(f"{node}/visual_{index}", mesh, at))
        if not meshes and (primitives := robot.descriptor.collision.get(link)):
            self._shapes.append(brush.mesh(f"{node}/shape", link_mesh(primitives), SE3.identity()))

    def move(self, joints: Array) -> bool:
        """Draw the robot at joint positions (J,) in rad; whether that changes anything."""
        if self._at is not None and np.abs(joints - self._at).max() < STILL:
            return False
        for frame, index, joint, at in self._moving:
            if self._at is None or abs(joints[index] - self._at[index]) >= STILL:
                pose = at @ motion(joint, float(joints[index]))
                if joint.type == "prismatic":
                    frame.position = pose.translation()
                else:
                    frame.wxyz = pose.rotation().wxyz
        self._at = joints.copy()
        return True

    def paint(self, colour: Colour) -> None:
        """Give every link this colour."""
        for shape in self._shapes:
            if tuple(shape.color) != colour:
                shape.color = colour

    def show_spheres(self, seen: bool) -> None:
        """Show the collision spheres of the links, or not."""
        while self._spheres:
            self._spheres.pop().remove()
        if seen:
            brush = Brush(self._api, SPHERES, 0.35)
            self._spheres = [
                brush.mesh(f"{self.nodes[link]}/spheres", link_mesh(spheres), SE3.identity())
                for link, spheres in self._robot.descriptor.spheres.items()
                if spheres and link in self.nodes
            ]

    def show_axes(self, seen: bool) -> None:
        """Show the frames of the links, or not."""
        while self._axes:
            self._axes.pop().remove()
        if seen:
            self._axes = [
                self._api.add_frame(f"{node}/axes", axes_length=0.15, axes_radius=0.004) for node in self.nodes.values()
            ]

    @property
    def visible(self) -> bool:
        """Whether it is in the picture."""
        return self._frame.visible

    @visible.setter
    def visible(self, seen: bool) -> None:
        if self._frame.visible != seen:
            self._frame.visible = seen


def _visuals(urdf: Path) -> dict[str, tuple[_Visual, ...]]:
    """The visual meshes of each link; a link is left out where one of its visuals is anything else or cannot be had here."""
    found: dict[str, tuple[_Visual, ...]] = {}
    for link in ET.parse(urdf).getroot().findall("link"):  # noqa: S314 - the robot's own file, read by load_robot before
        visuals = [_visual(element, urdf.parent) for element in link.findall("visual")]
        known = tuple(visual for visual in visuals if visual is not None)
        if known and len(known) == len(visuals):
            found[link.get("name", "")] = known
    return found


def _visual(element: ET.Element, folder: Path) -> _Visual | None:
    mesh, at = element.find("geometry/mesh"), element.find("origin")
    if mesh is None:
        return None
    file = folder / mesh.get("filename", "").removeprefix("file://")
    if file.suffix.lower() not in _FORMATS or not file.is_file():
        return None
    x, y, z = _numbers(mesh.get("scale", "1 1 1"))
    place = SE3.identity()
    if at is not None:
        turn = SO3.from_rpy_radians(*_numbers(at.get("rpy", "0 0 0")))
        place = SE3.from_rotation_and_translation(turn, np.array(_numbers(at.get("xyz", "0 0 0"))))
    return _Visual(file, (x, y, z), place)


def _numbers(text: str) -> tuple[float, float, float]:
    x, y, z = map(float, text.split())
    return x, y, z
