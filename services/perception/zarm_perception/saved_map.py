"""The voxel map as it is saved and loaded."""

from __future__ import annotations

import zlib
from base64 import b64decode, b64encode

import numpy as np

from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import LoadedMap, SavedMap
from zarm_perception.kernels.integration import OCCUPIED
from zarm_perception.voxel_map import MAX_VOXELS, VoxelMap

_OFF_GRID = 0.01
"""How far the voxels of a saved map may lie off those of the map, in widths."""


def save(voxels: VoxelMap) -> SavedMap:
    """The whole map."""
    x, y, z = voxels.lower.tolist()
    nx, ny, nz = voxels.states.shape
    packed = b64encode(zlib.compress(voxels.states.tobytes())).decode()
    return SavedMap(lower=(x, y, z), resolution=voxels.resolution, shape=(nx, ny, nz), states=packed)


def load(voxels: VoxelMap, saved: SavedMap) -> LoadedMap:
    """Replace the map by a saved one. Raises InvalidRequest if its voxels are not as wide, or lie between those of the map."""
    if abs(saved.resolution - voxels.resolution) > 1e-9:
        raise InvalidRequest(
            f"the saved voxels are {1000.0 * saved.resolution:g} mm wide, those of the map {1000.0 * voxels.resolution:g} mm; start "
            f"zarm-perception with --resolution {saved.resolution:g}",
            field="resolution",
        )
    offset = (np.array(saved.lower) - voxels.lower) / voxels.resolution
    first = np.rint(offset)
    if np.abs(offset - first).max() > _OFF_GRID:
        corner = ",".join(f"{value:g}" for value in saved.lower)
        raise InvalidRequest(
            f"the saved voxels lie between those of the map; start zarm-perception with a --box that begins at {corner}",
            field="lower",
        )
    size = int(np.prod(saved.shape))
    if size > MAX_VOXELS:
        raise InvalidRequest(f"{size} voxels; a map has at most {MAX_VOXELS}", field="shape")
    try:
        packed = zlib.decompressobj()
        states = np.frombuffer(packed.decompress(b64decode(saved.states, validate=True), size), np.uint8)
    except (ValueError, zlib.error) as error:
        raise InvalidRequest("not compressed by zlib, in base64; save the map again", field="states") from error
    if states.size != size or packed.unconsumed_tail or states.max() > OCCUPIED:
        raise InvalidRequest(f"there must be {size} states, each 0, 1 or 2; save the map again", field="states")
    i, j, k = (int(n) for n in first)
    outside = voxels.load(states.reshape(saved.shape), (i, j, k))
    return LoadedMap(occupied=int(np.count_nonzero(states == OCCUPIED)), outside=outside)
