"""Waypoints of the next plan: handles to drag in the 3D view."""

from __future__ import annotations

from typing import NamedTuple

from viser import GuiDropdownHandle, GuiFolderHandle, LabelHandle, TransformControlsHandle
from viser.transforms import SE3

from zarm.values import pose_of
from zarm_viewer.kinematics import message_of, pose_at
from zarm_viewer.panel_context import PanelContext
from zarm_viewer.way_options import MIDDLE, QUICKEST, STRAIGHT, Passed


class _Handle(NamedTuple):
    gizmo: TransformControlsHandle
    label: LabelHandle
    way: GuiDropdownHandle[str]


class WaypointHandles:
    """Poses of the tip, passed in the order of their numbers before the goal is reached; the ways to them are chosen in a `folder`."""

    def __init__(self, panels: PanelContext, folder: GuiFolderHandle) -> None:
        self._panels, self._folder = panels, folder
        self._handles: list[_Handle] = []

    def add(self, pose: SE3) -> None:
        """Add one after the others."""
        scene, number = self._panels.server.scene, len(self._handles) + 1
        node = f"{self._panels.root}/waypoint_{number}"
        gizmo = scene.add_transform_controls(
            node,
            scale=0.22,
            line_width=3.0,
            depth_test=False,
            position=pose.translation(),
            wxyz=pose.rotation().wxyz,
        )
        with self._folder:
            way = self._panels.server.gui.add_dropdown(f"way to {number}", (QUICKEST, STRAIGHT, MIDDLE))
        self._handles.append(_Handle(gizmo, scene.add_label(f"{node}/label", f"{number}"), way))

    def clear(self) -> None:
        """Remove all."""
        while self._handles:
            for handle in reversed(self._handles.pop()):
                handle.remove()

    def show(self, seen: bool) -> None:
        """Show or hide the handles."""
        for handle in self._handles:
            handle.gizmo.visible = seen

    @property
    def passed(self) -> tuple[Passed, ...]:
        """Their current poses in the base frame, and the ways to them."""
        return tuple(Passed(pose_of(message_of(pose_at(one.gizmo))), one.way.value) for one in self._handles)
