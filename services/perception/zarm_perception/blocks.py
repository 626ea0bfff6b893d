"""The voxel map as messages: a block for each cube of voxels that has changed."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterator

import numpy as np

from zarm_contract.messages import VoxelBlock
from zarm_contract.messages.perception import BLOCK
from zarm_perception.voxel_map import VoxelMap


class Blocks:
    """The blocks of a map that differ from what they were when they were last asked for; at first all, free ones too: an earlier
    map may have had something there.
    """

    def __init__(self, voxels: VoxelMap) -> None:
        self._voxels = voxels
        self._last: dict[str, str] = {}

    def changed(self) -> Iterator[tuple[str, VoxelBlock]]:
        """Name and message of each."""
        for index, first, occupied in self._voxels.changes():
            full = np.zeros((BLOCK,) * 3, np.bool_)
            full[tuple(slice(0, n) for n in occupied.shape)] = occupied
            cells = b64encode(np.packbits(full).tobytes()).decode() if occupied.any() else ""
            name = "{}.{}.{}".format(*index)
            if self._last.get(name) != cells:
                self._last[name] = cells
                x, y, z = first.tolist()
                yield name, VoxelBlock(position=(x, y, z), resolution=self._voxels.resolution, cells=cells)
