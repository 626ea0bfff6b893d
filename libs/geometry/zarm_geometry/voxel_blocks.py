"""The voxel map as objects: one for each block that holds occupied voxels."""

from __future__ import annotations

import threading
import time
from base64 import b64decode
from collections.abc import Callable, Mapping
from itertools import compress, product

import numpy as np

from zarm_contract.messages import VOXEL_MAP, PerceptionState, VoxelBlock, Voxels
from zarm_contract.messages.perception import BLOCK

MAP = f"{VOXEL_MAP}."
"""With this begin the names of its objects; the name of the block follows."""

_MAX_BLOCK_LEAD = 2.0
"""So long (s) a block may be ahead of the state of its map."""
_CELLS = [*product(range(BLOCK), range(BLOCK), range(BLOCK))]
"""The voxels of a block in the order of its bits."""


class VoxelBlocks:
    """The newest blocks of the voxel map. Thread-safe. `changed()` is called after every change."""

    def __init__(self, changed: Callable[[], object] = lambda: None) -> None:
        self._changed = changed
        self._lock = threading.Lock()
        self._objects: Mapping[str, Voxels] = {}
        self._arrived: dict[str, float] = {}

    @property
    def objects(self) -> Mapping[str, Voxels]:
        """The objects by name: the same mapping as long as nothing has changed, and the same object for a block that has not."""
        return self._objects

    def receive(self, key: str, block: VoxelBlock) -> None:
        """Take a block on its key."""
        name = MAP + key.rpartition("/")[2]
        with self._lock:
            objects = {other: item for other, item in self._objects.items() if other != name}
            if block.cells:
                objects[name], self._arrived[name] = _voxels(name, block), time.monotonic()
            self._objects = objects
        self._changed()

    def on_state(self, _key: str, state: PerceptionState) -> None:
        """Drop the blocks that are not where the map has one of that name: they are of an earlier map with another box. One that has just come
        may be ahead of the state of its map.
        """
        now = time.monotonic()
        with self._lock:
            gone = {
                name
                for name, item in self._objects.items()
                if now - self._arrived[name] > _MAX_BLOCK_LEAD and not _is_of(item, state)
            }
            if not gone:
                return
            self._objects = {name: item for name, item in self._objects.items() if name not in gone}
        self._changed()


def _is_of(item: Voxels, state: PerceptionState) -> bool:
    """Whether a map with this state has this block there."""
    index = map(int, item.name.removeprefix(MAP).split("."))
    return item.resolution == state.resolution and all(
        abs(low + (BLOCK * k + 0.5) * state.resolution - at) < 0.5 * state.resolution and at < high
        for low, high, k, at in zip(state.lower, state.upper, index, item.position, strict=True)
    )


def _voxels(name: str, block: VoxelBlock) -> Voxels:
    bits = np.unpackbits(np.frombuffer(b64decode(block.cells), np.uint8))
    cells = tuple(compress(_CELLS, bits.tolist()))
    return Voxels.model_construct(  # from the fields of a valid block
        kind="voxels",
        name=name,
        position=block.position,
        orientation=(0.0, 0.0, 0.0, 1.0),
        resolution=block.resolution,
        cells=cells,
    )
