"""A robot in the 3D view: as measured, as a ghost, or at a goal."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping

import numpy as np
import viser
from viser import MeshHandle, SceneNodeHandle
from viser.transforms import SE3

from zarm_contract.robot import RobotDescription
from zarm_contract.urdf import Joint
from zarm_trajectory.arrays import Array
from zarm_viewer.body import Body
from zarm_viewer.drawing import Brush, Colour, link_mesh
from zarm_viewer.kinematics import motion, origin

SPHERES = (250, 176, 5)
REDRAW_THRESHOLD = 1e-4
"""A joint that has moved less than this (rad or m) is not redrawn."""


class Arm:
    """A drawing of a robot under the node `root`; the browser places each link relative to its parent, so that only
    joints are sent.
    """

    def __init__(
        self, api: viser.SceneApi, root: str, robot: RobotDescription, body: Body, colour: Colour, opacity: float
    ) -> None:
        self._frame = api.add_frame(root, show_axes=False)
        self._shapes: list[MeshHandle] = []
        self._at: Array | None = None
        brush = Brush(api, colour, opacity)
        joints = {joint.child: joint for joint in robot.urdf.joint_of_child.values()}
        names = {robot.descriptor.base_link: root}
        waiting = list(joints.values())
        moving: dict[str, tuple[SceneNodeHandle, int]] = {}
        frames: dict[str, tuple[SceneNodeHandle, Joint]] = {}
        while ready := [joint for joint in waiting if joint.parent in names]:
            for joint in ready:
                waiting.remove(joint)
                names[joint.child] = f"{names[joint.parent]}/{joint.child}"
                at = origin(joint)
                frame = api.add_frame(
                    names[joint.child], show_axes=False, wxyz=at.rotation().wxyz, position=at.translation()
                )
                frames[joint.name] = frame, joint
                if joint.name in robot.descriptor.joints:
                    moving[joint.child] = frame, robot.descriptor.joints.index(joint.name)
        self._fingers = {joint: frames[joint] for joint in robot.gripper_positions({})}
        self._moving = [(frame, index, joints[link], origin(joints[link])) for link, (frame, index) in moving.items()]
        self.tip = names[robot.descriptor.tip_link]
        self.nodes = names  # of each link in the scene
        self._api, self._robot = api, robot
        self._spheres: list[MeshHandle] = []
        self._axes: list[SceneNodeHandle] = []
        for link, node in names.items():
            for index, (mesh, at) in enumerate(body.get(link, ())):
                self._shapes.append(brush.mesh(f"{node}/shape_{index}", mesh, at))
        self.move(np.array(robot.descriptor.home))
        self.grip({})

    def move(self, joints: Array) -> bool:
        """Draw the robot at joint positions (J,) in rad; returns whether that changes anything."""
        if self._at is not None and np.abs(joints - self._at).max() < REDRAW_THRESHOLD:
            return False
        for frame, index, joint, at in self._moving:
            if self._at is None or abs(joints[index] - self._at[index]) >= REDRAW_THRESHOLD:
                _place(frame, joint, at @ motion(joint, float(joints[index])))
        self._at = joints.copy()
        return True

    def grip(self, widths: Mapping[str, float]) -> None:
        """Draw the fingers of grippers at these openings (m), those left out open."""
        for name, position in self._robot.gripper_positions(widths).items():
            frame, joint = self._fingers[name]
            _place(frame, joint, origin(joint) @ motion(joint, position))

    def paint(self, colour: Colour) -> None:
        """Give every link this colour."""
        for shape in self._shapes:
            if tuple(shape.color) != colour:
                shape.color = colour

    def show_spheres(self, seen: bool) -> None:
        """Show or hide the links' collision spheres."""
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
        """Show or hide the links' frames."""
        while self._axes:
            self._axes.pop().remove()
        if seen:
            self._axes = [
                self._api.add_frame(f"{node}/axes", axes_length=0.15, axes_radius=0.004) for node in self.nodes.values()
            ]

    @property
    def visible(self) -> bool:
        """Whether the robot is drawn."""
        return self._frame.visible

    @visible.setter
    def visible(self, seen: bool) -> None:
        if self._frame.visible != seen:
            self._frame.visible = seen


def _place(frame: SceneNodeHandle, joint: Joint, pose: SE3) -> None:
    """Put the child of a joint there."""
    if joint.type == "prismatic":
        frame.position = pose.translation()
    else:
        frame.wxyz = pose.rotation().wxyz


class Ghost:
    """A robot sent to the pages only when first shown, so that they open faster. Thread-safe."""

    def __init__(self, make: Callable[[], Arm]) -> None:
        self._make, self._making = make, threading.Lock()
        self._arm: Arm | None = None
        self._widths: Mapping[str, float] = {}

    def show(self, joints: Array) -> None:
        """Show it at joint positions (J,) in rad."""
        with self._making:
            if self._arm is None:
                self._arm = self._make()
                self._arm.grip(self._widths)
        self._arm.move(joints)
        self._arm.visible = True

    def grip(self, widths: Mapping[str, float]) -> None:
        """Draw the fingers of its grippers at these openings (m)."""
        with self._making:
            self._widths = widths
            if self._arm is not None:
                self._arm.grip(widths)

    def hide(self) -> None:
        """Hide it."""
        if self._arm is not None:
            self._arm.visible = False

    def paint(self, colour: Colour) -> None:
        """Give it this colour, if it has been shown."""
        if self._arm is not None:
            self._arm.paint(colour)
