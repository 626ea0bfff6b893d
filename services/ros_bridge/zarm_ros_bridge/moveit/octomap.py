"""The voxel map as an octomap."""

from __future__ import annotations

from array import array
from collections.abc import Collection
from typing import Any

import numpy as np
from geometry_msgs.msg import Point, Pose
from moveit_msgs.msg import PlanningScene
from numpy.typing import NDArray

from zarm_contract.messages import Voxels

Keys = NDArray[np.int64]

_DEPTH = 16
"""Levels of an octree of OctoMap below its root."""
_OCCUPIED, _INNER = 0b10, 0b11
"""A child in a node, two bits each, the first child in the lowest: 00 unknown, 01 free, 10 occupied, 11 a node of its own. See
`OccupancyOcTreeBase::writeBinaryNode` of OctoMap 1.10.
"""


def octomap(blocks: Collection[Voxels], frame: str) -> Any:
    """An `OctomapWithPose` in which the cells of these voxels, all of one resolution and on one grid, are occupied, and nothing is known of the rest."""
    message = PlanningScene().world.octomap
    message.header.frame_id = frame
    if not blocks:
        return message
    resolution = next(iter(blocks)).resolution
    centers = np.concatenate([np.array(block.cells) * resolution + block.position for block in blocks])
    # Cells of an octree begin at multiples of its resolution.
    x, y, z = ((centers[0] / resolution - 0.5) % 1.0 * resolution).tolist()
    message.origin = Pose(position=Point(x=x, y=y, z=z))
    cells = np.rint((centers - (x, y, z)) / resolution - 0.5).astype(np.int64)
    message.octomap.header.frame_id = frame
    message.octomap.binary, message.octomap.id, message.octomap.resolution = True, "OcTree", resolution
    message.octomap.data = array("b", tree(cells + (1 << _DEPTH - 1)).tobytes())
    return message


def tree(keys: Keys) -> NDArray[np.uint8]:
    """The binary data of an octree in which the cells with these keys (n, 3), from 0 to 65535, are occupied: its nodes in the order of a depth-first
    search, two bytes each.
    """
    codes = np.unique(_interleaved(keys))
    below, parts = np.full(len(codes), _OCCUPIED, np.uint16), []
    for level in range(_DEPTH):
        parents, index = np.unique(codes >> 3, return_inverse=True)
        nodes = np.zeros(len(parents), np.uint16)
        np.bitwise_or.at(nodes, index, below << (2 * (codes & 7)).astype(np.uint16))
        first = parents << 3 * (level + 1)  # the code of its first possible cell
        parts.append((first, np.full(len(first), _DEPTH - level), nodes))
        codes, below = parents, np.full(len(parents), _INNER, np.uint16)
    first, depth, nodes = (np.concatenate(part) for part in zip(*parts, strict=True))
    return nodes[np.lexsort((depth, first))].astype("<u2").view(np.uint8)


def _interleaved(keys: Keys) -> Keys:
    """The bits of each key from the highest on, in groups of three, x in the lowest."""
    codes = np.zeros(len(keys), np.int64)
    for bit in range(_DEPTH):
        for axis in range(3):
            codes |= (keys[:, axis] >> bit & 1) << (3 * bit + axis)
    return codes
