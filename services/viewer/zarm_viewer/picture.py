"""The robot in the 3D view: measured, its ghost, the trail of its tip and the planned path."""

from __future__ import annotations

from collections import deque
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zarm_contract.messages import Trajectory, Vector3
from zarm_trajectory.arrays import Array
from zarm_trajectory.trajectory import TimedTrajectory
from zarm_viewer.arm import Arm, Ghost
from zarm_viewer.camera_view import CameraView
from zarm_viewer.panel_context import PanelContext
from zarm_viewer.scene_view import SceneView
from zarm_viewer.simulation_view import SimulationView
from zarm_viewer.voxel_view import VoxelView
from zarm_viewer.watching import News

MEASURED, GHOST = (222, 226, 230), (90, 200, 250)
TRAIL, CLEARANCE = (250, 176, 5), (224, 49, 49)
SLOW, FAST = (116, 143, 252), (64, 192, 87)
"""The planned path, where the tip moves slowest and fastest."""
TRAIL_POINTS, PATH_POINTS = 150, 120
TRAIL_STEP = 0.005
"""Distance (m) between points of the trail."""
_GHOST_THRESHOLD = 0.005  # rad between ghost and robot above which the ghost is shown


def speed_colours(points: Array) -> NDArray[np.uint8]:
    """Colours (n - 1, 2, 3) of the segments between points (n, 3) that follow each other at equal times: FAST where they are
    longest.
    """
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    share = (lengths / max(float(lengths.max(initial=0.0)), 1e-9))[:, None, None]
    colours = (1.0 - share) * np.array(SLOW) + share * np.array(FAST)
    return np.repeat(colours.round().astype(np.uint8), 2, axis=1)


class Picture:
    """The drawings of one robot."""

    def __init__(self, panels: PanelContext, meshes: tuple[Path, ...]) -> None:
        self._panels = panels
        scene = panels.server.scene
        robot, body = panels.description, panels.body
        self.arm = Arm(scene, f"{panels.root}/robot", robot, body, MEASURED, 1.0)
        self._ghost = Ghost(lambda: Arm(scene, f"{panels.root}/ghost", robot, body, GHOST, 0.35))
        scene.add_frame(f"{self.arm.tip}/tip_axes", axes_length=0.12, axes_radius=0.004)
        self.scene = SceneView(panels, self.arm.nodes, self.arm.tip, meshes)
        self._voxels = VoxelView(panels)
        self._simulation = SimulationView(panels, meshes)
        self._cameras = CameraView(panels, self.arm.nodes)
        self._trail: deque[Array] = deque(maxlen=TRAIL_POINTS)
        self._preview: Array | None = None
        self._widths: dict[str, float] = {}
        self._clearance: tuple[Vector3, Vector3] | None = None

    def draw(self, news: News) -> None:
        """Show what has changed."""
        if news.joints is not None:
            self._panels.joints, self._panels.measured = news.joints, True
            if self.arm.move(news.joints):
                self._extend_trail(news.joints)
        if news.grippers:
            self._widths |= {state.gripper: state.width for state in news.grippers if state.width is not None}
            self.arm.grip(self._widths)
            self._ghost.grip(self._widths)
        if news.preview is not None:
            self._preview = news.preview
        if self._preview is not None:
            if float(np.abs(self._preview - self._panels.joints).max()) > _GHOST_THRESHOLD:
                self._ghost.show(self._preview)
            else:
                self._ghost.hide()
        if news.scene is not None:
            self._panels.mount(news.scene.tools)
            self.scene.draw(news.scene)
            self._simulation.believe(news.scene.objects)
        if news.voxels is not None:
            self._voxels.draw(news.voxels)
        self._voxels.fade()
        if news.simulated is not None:
            self._simulation.draw_objects(news.simulated)
        if news.physics is not None:
            self._simulation.draw_state(news.physics)
        if news.cameras is not None:
            self._cameras.draw(news.cameras)
        self._cameras.draw_images(news.images, news.masks)
        if news.plan is not None:
            self._draw_path(news.plan.trajectory)
        elif news.trajectory is not None:
            self._draw_path(news.trajectory.trajectory)

    def forget_path(self) -> None:
        """Remove the path of a plan that no longer holds."""
        self._panels.server.scene.remove_by_name(f"{self._panels.root}/path")

    def show_clearance(self, points: tuple[Vector3, Vector3] | None) -> None:
        """Show a line between two points (m) in the base frame, or none."""
        if points != self._clearance:
            self._clearance = points
            if points is not None:
                self._line("clearance", np.array(points), CLEARANCE)
            else:
                self._panels.server.scene.remove_by_name(f"{self._panels.root}/clearance")

    def _extend_trail(self, joints: Array) -> None:
        at = np.asarray(self._panels.chain.tip(joints).translation(), dtype=np.float64)
        if not self._trail or np.linalg.norm(at - self._trail[-1]) > TRAIL_STEP:
            self._trail.append(at)
            self._line("trail", np.array(self._trail), TRAIL)

    def _draw_path(self, trajectory: Trajectory) -> None:
        timed = TimedTrajectory.of(trajectory, self._panels.description.descriptor.joints)
        times = np.linspace(float(timed.time[0]), timed.duration, PATH_POINTS)
        points = np.array([self._panels.chain.tip(row).translation() for row in timed.positions(times)])
        self._line("path", points, speed_colours(points))

    def _line(self, name: str, points: Array, colour: tuple[int, int, int] | NDArray[np.uint8]) -> None:
        if len(points) > 1:
            self._panels.server.scene.add_line_segments(
                f"{self._panels.root}/{name}",
                np.stack((points[:-1], points[1:]), axis=1).astype(np.float32),
                colour,
                thickness=0.008,
            )
