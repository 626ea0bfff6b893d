"""The simulation with physics in the 3D view: its objects where they really are, and what presses on what."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np
from viser import SceneNodeHandle

from zarm_contract.messages import Contact, PhysicsObjects, PhysicsState, SceneObject
from zarm_trajectory.arrays import Array
from zarm_viewer.drawing import Brush, draw_object
from zarm_viewer.panel_context import PanelContext

BODY, PRESSING = (166, 124, 82), (224, 49, 49)
FORCE_LENGTH, LONGEST = 0.01, 0.3
"""Length (m) of the line of a force per N, and the most."""
_MIN_FORCE = 0.05
"""Least force (N) that is shown."""


class SimulationView:
    """Draws the simulated objects that move or are not in the scene, and a line for each contact force."""

    def __init__(self, panels: PanelContext, meshes: tuple[Path, ...]) -> None:
        self._panels, self._meshes = panels, meshes
        self._objects: tuple[SceneObject, ...] = ()
        self._moving: frozenset[str] = frozenset()
        self._believed: Collection[SceneObject] = ()
        self._drawn: dict[str, tuple[SceneObject, SceneNodeHandle | None]] = {}
        self._forces = forces(())

    def believe(self, scene: Sequence[SceneObject]) -> None:
        """Leave out what stands in the scene as it is."""
        self._believed = scene
        self._draw_objects()

    def draw_objects(self, message: PhysicsObjects) -> None:
        """Show these objects."""
        self._objects = message.objects
        self._draw_objects()

    def draw_state(self, state: PhysicsState) -> None:
        """Show where what moves is now, and the forces."""
        moving = frozenset(body.name for body in state.bodies)
        if moving != self._moving:
            self._moving = moving
            self._draw_objects()
        for body in state.bodies:
            _, handle = self._drawn.get(body.name, (None, None))
            if handle is not None:
                x, y, z, w = body.orientation
                handle.position, handle.wxyz = np.array(body.position), np.array((w, x, y, z))
        self._draw_forces(forces(state.contacts))

    def _draw_objects(self) -> None:
        wanted = {item.name: item for item in self._objects if item.name in self._moving or item not in self._believed}
        for name in [name for name, (item, _) in self._drawn.items() if wanted.get(name) != item]:
            if (handle := self._drawn.pop(name)[1]) is not None:
                handle.remove()
        brush = Brush(self._panels.server.scene, BODY)
        for name, item in wanted.items():
            if name not in self._drawn:
                node = f"{self._panels.root}/simulation/{name}"
                self._drawn[name] = item, draw_object(brush, node, item, self._meshes)

    def _draw_forces(self, lines: Array) -> None:
        if np.array_equal(lines, self._forces):
            return
        self._forces = lines
        node, api = f"{self._panels.root}/forces", self._panels.server.scene
        if len(lines):
            api.add_line_segments(node, lines, PRESSING, thickness=0.01)
        else:
            api.remove_by_name(node)


def forces(contacts: Sequence[Contact]) -> Array:
    """Lines (n, 2, 3) in m from where two press on each other, as long as the force, to both sides."""
    shown = [contact for contact in contacts if contact.force >= _MIN_FORCE]
    at = np.array([contact.position for contact in shown]).reshape(-1, 3)
    normal = np.array([contact.normal for contact in shown]).reshape(-1, 3)
    length = np.clip([FORCE_LENGTH * contact.force for contact in shown], 0.0, LONGEST).reshape(-1, 1)
    return np.stack((at - length * normal, at + length * normal), axis=1).astype(np.float32)
