"""The voxel map in the 3D view: what has just been seen stands out, and fades with its age."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from viser import PointCloudHandle

from zarm_contract.messages import Voxels
from zarm_contract.messages.perception import BLOCK
from zarm_trajectory.arrays import Array
from zarm_viewer.panel_context import PanelContext

NEW, OLD = (250, 176, 5), (150, 130, 170)
FADES = 10.0
"""Age (s) at which a voxel has the colour OLD."""
_OPENING = 2.0
"""What comes in this time (s) after the page was opened may be of any age, and has the colour OLD."""
_PERIOD = 0.5
"""Least time (s) between two changes of the colours."""


@dataclass
class _Block:
    item: Voxels
    since: Array
    """When each voxel of the block became occupied (16, 16, 16), as far as the page has seen it; NaN for a free one."""
    handle: PointCloudHandle
    fades_until: float


class VoxelView:
    """Draws the blocks of the map of one robot."""

    def __init__(self, panels: PanelContext) -> None:
        self._panels = panels
        self._blocks: dict[str, _Block] = {}
        self._begun, self._coloured_at = math.inf, -math.inf

    def draw(self, blocks: Mapping[str, Voxels]) -> None:
        """Show this map."""
        now = time.monotonic()
        self._begun = min(self._begun, now)
        gone = {
            name: self._blocks.pop(name)
            for name, block in [*self._blocks.items()]
            if blocks.get(name) is not block.item
        }
        for block in gone.values():
            block.handle.remove()
        for name, item in blocks.items():
            if name not in self._blocks:
                before = gone[name].since if name in gone else np.full((BLOCK, BLOCK, BLOCK), np.nan)
                self._blocks[name] = self._add(name, item, before, now)

    def fade(self) -> None:
        """Let colours follow the ages."""
        now = time.monotonic()
        if now - self._coloured_at >= _PERIOD:
            for block in self._blocks.values():
                if block.fades_until > self._coloured_at:
                    block.handle.colors = colours(_at(block.since, block.item), now)
            self._coloured_at = now

    def _add(self, name: str, item: Voxels, before: Array, now: float) -> _Block:
        opening = now - self._begun < _OPENING
        since, cells = np.full_like(before, np.nan), np.array(item.cells, dtype=np.intp)
        known = _at(before, item)
        times = np.where(np.isnan(known), -math.inf if opening else now, known)
        since[tuple(cells.T)] = times
        handle = self._panels.server.scene.add_point_cloud(
            f"{self._panels.root}/map/{name}",
            cells.astype(np.float32) * item.resolution,
            colours(times, now),
            point_size=item.resolution,
            point_shape="square",
            precision="float32",
            position=item.position,
        )
        return _Block(item, since, handle, float(times.max()) + FADES)


def _at(since: Array, item: Voxels) -> Array:
    """The values (n,) of the occupied voxels."""
    return np.asarray(since[tuple(np.array(item.cells, dtype=np.intp).T)])


def colours(since: Array, now: float) -> NDArray[np.uint8]:
    """The colours (n, 3) of voxels that have been occupied `since` (n,)."""
    share = np.clip((now - since) / FADES, 0.0, 1.0)[:, None]
    return np.asarray(np.rint((1.0 - share) * np.array(NEW) + share * np.array(OLD)), np.uint8)
