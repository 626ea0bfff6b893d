"""The scene in the 3D view: objects, and what the robot carries."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from viser import SceneNodeHandle
from viser.transforms import SE3

from zarm_contract.messages import Scene, SceneObject
from zarm_trajectory.arrays import Array
from zarm_viewer.drawing import Brush, draw_object
from zarm_viewer.panel_context import PanelContext
from zarm_viewer.picking import distance

OBJECT, CARRIED = (120, 144, 176), (230, 160, 60)


class SceneView:
    """Draws the changes from one scene to the next. `nodes` are those of the links, which carry attached objects; `tip` is one of them."""

    def __init__(self, panels: PanelContext, nodes: Mapping[str, str], tip: str, meshes: tuple[Path, ...]) -> None:
        self._panels, self._nodes, self._tip, self._meshes = panels, nodes, tip, meshes
        self._drawn: dict[str, tuple[SceneObject, SceneNodeHandle | None]] = {}

    def draw(self, scene: Scene) -> None:
        """Show this scene."""
        wanted: dict[str, tuple[str, SceneObject, bool]] = {}
        for item in scene.objects:
            wanted[f"{self._panels.root}/scene/{item.name}"] = item.name, item, False
        for carried in scene.attached:
            carrier = self._tip if carried.link is None else self._nodes[carried.link]
            wanted[f"{carrier}/carried_{carried.object.name}"] = carried.object.name, carried.object, True
        for node in [node for node, (item, _) in self._drawn.items() if node not in wanted or wanted[node][1] != item]:
            _, handle = self._drawn.pop(node)
            if handle is not None:
                handle.remove()
        for node, (name, item, carried_too) in wanted.items():
            if node not in self._drawn:
                brush = Brush(self._panels.server.scene, CARRIED if carried_too else OBJECT, 0.9)
                handle = draw_object(brush, node, item, self._meshes)
                self._drawn[node] = item, handle
                if handle is None:
                    self._panels.note(f"{name} is not drawn: its mesh is in none of the viewer's --meshes folders")

    def place(self, name: str, at: SE3) -> None:
        """Show an object at another pose during a drag; the next scene has its true pose."""
        _, handle = self._drawn.get(f"{self._panels.root}/scene/{name}", (None, None))
        if handle is not None:
            handle.position, handle.wxyz = at.translation(), at.rotation().wxyz

    def hit(self, origin: Array, direction: Array) -> str | None:
        """The name of the object that a ray in the base frame hits first, None if it hits none; attached ones do not count."""
        found = {
            item.name: distance(origin, direction, handle)
            for node, (item, handle) in self._drawn.items()
            if handle is not None and node.startswith(f"{self._panels.root}/scene/")
        }
        nearest = min(found, key=found.__getitem__, default=None)
        return nearest if nearest is not None and found[nearest] < np.inf else None
