"""Voxels as an octomap, and an octomap as voxels."""

from __future__ import annotations

import struct
from array import array
from collections.abc import Callable, Collection
from typing import Any

import numpy as np
from geometry_msgs.msg import Point, Pose
from moveit_msgs.msg import MoveItErrorCodes as Val
from moveit_msgs.msg import PlanningScene
from numpy.typing import NDArray

from zarm_contract.messages import MAX_CELLS, Voxels
from zarm_geometry.frames import matrix, pose_of
from zarm_ros_bridge.convert.poses import pose_of as ros_pose_of
from zarm_ros_bridge.moveit.error_codes import Refusal
from zarm_trajectory.arrays import Array

Keys = NDArray[np.int64]

FINEST, COARSEST = 0.002, 1.0
"""Edges (m) of the cells that the scene takes."""
OCTOMAP_NS = "<octomap>"
"""What MoveIt calls the octomap in the allowed collision matrix."""
OCTOMAP = "octomap"
"""The object of the scene that a client's octomap is."""
MAX_OCCUPIED_CELLS = 1_000_000
"""Most occupied cells of a map that is taken."""
_CORNERS = np.array([[child >> axis & 1 for axis in range(3)] for child in range(8)], np.int64)
"""Where the children of a node begin, x in the lowest bit."""

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
    x, y, z = (np.round(centers[0] / resolution - 0.5, 6) % 1.0 * resolution).tolist()
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


def voxels_of(message: Any, frame: Array | None, name: str) -> tuple[Voxels, ...]:
    """The occupied cells of an `OctomapWithPose`, whose header's frame is at `frame` (4, 4), as objects called `name`, or `name..0` and so on if
    they are many. Raises Refusal for what is no map of MoveIt's, and for more than a million cells, and InvalidRequest for a pose.
    """
    cells, resolution = cells_of(message.octomap), message.octomap.resolution
    if not len(cells):
        return ()
    if not FINEST <= resolution <= COARSEST:
        raise Refusal(
            Val.FAILURE,
            f"cells of {resolution:g} m are not taken; they have {FINEST:g} to {COARSEST:g} m",
            "world.octomap.octomap.resolution",
        )
    origin = ros_pose_of(message.origin, "world.octomap.origin")
    own = matrix(origin.position, origin.orientation)
    whole = own if frame is None else frame @ own
    first_center = whole.copy()
    first_center[:3, 3] += whole[:3, :3] @ np.full(3, resolution / 2.0)
    pose = pose_of(first_center)
    parts = [cells[first : first + MAX_CELLS] for first in range(0, len(cells), MAX_CELLS)]
    names = [name] if len(parts) == 1 else [f"{name}..{i}" for i in range(len(parts))]
    return tuple(
        Voxels(
            kind="voxels",
            name=each,
            position=pose.position,
            orientation=pose.orientation,
            resolution=resolution,
            cells=tuple((i, j, k) for i, j, k in part.tolist()),
        )
        for each, part in zip(names, parts, strict=True)
    )


def cells_of(message: Any) -> Keys:
    """The occupied cells (n, 3) of an `Octomap`; cell (0, 0, 0) begins at its origin. Raises Refusal."""
    if message.id != "OcTree":
        raise Refusal(Val.FAILURE, f"{message.id!r} is no map of MoveIt's; send an OcTree", "world.octomap.octomap.id")
    data = np.array(message.data, np.int8).tobytes()
    leaves = _Leaves(data, _binary_node if message.binary else _full_node)
    try:
        if data:
            leaves.read(0, np.zeros(3, np.int64), 1 << _DEPTH)
    except (IndexError, struct.error):
        raise Refusal(Val.FAILURE, "the octree ends in the middle of a node", "world.octomap.octomap.data") from None
    if not leaves.found:
        return np.empty((0, 3), np.int64)
    return np.concatenate(leaves.found) - (1 << _DEPTH - 1)


def _binary_node(data: bytes, at: int) -> tuple[int, list[int], list[int], bool]:
    """Where the next node begins, which children are nodes and which are occupied leaves; a node itself is none."""
    bits = data[at] | data[at + 1] << 8
    kinds = [bits >> 2 * child & 0b11 for child in range(8)]
    inner = [child for child, kind in enumerate(kinds) if kind == _INNER]
    return at + 2, inner, [child for child, kind in enumerate(kinds) if kind == _OCCUPIED], False


def _full_node(data: bytes, at: int) -> tuple[int, list[int], list[int], bool]:
    """The same of a node with its log odds, a 32-bit float, and the children that it has, a bit each; without any it is a leaf."""
    (odds,) = struct.unpack_from("<f", data, at)
    inner = [child for child in range(8) if data[at + 4] >> child & 1]
    return at + 5, inner, [], not inner and odds > 0.0


class _Leaves:
    """The keys (n, 3) of occupied cells, `found` in an octree of which `node` reads a node."""

    def __init__(self, data: bytes, node: Callable[[bytes, int], tuple[int, list[int], list[int], bool]]) -> None:
        self._data, self._node = data, node
        self._count = 0
        self.found: list[Keys] = []

    def read(self, at: int, corner: Keys, size: int) -> int:
        """Read the node at a place in the data, which covers the cells from `corner` (3,) on; where the next one begins."""
        if size < 1:
            raise Refusal(Val.FAILURE, "the octree is deeper than 16 levels", "world.octomap.octomap.data")
        after, inner, leaves, whole = self._node(self._data, at)
        if whole:
            self._add(corner, size)
        for child in leaves:
            self._add(corner + size // 2 * _CORNERS[child], size // 2)
        for child in inner:
            after = self.read(after, corner + size // 2 * _CORNERS[child], size // 2)
        return after

    def _add(self, corner: Keys, size: int) -> None:
        self._count += size**3
        if self._count > MAX_OCCUPIED_CELLS:
            raise Refusal(
                Val.FAILURE,
                f"more than {MAX_OCCUPIED_CELLS} cells are occupied; send a map of what is near the robot, or a coarser one",
                "world.octomap.octomap.data",
            )
        self.found.append(corner + np.argwhere(np.ones((size, size, size), np.bool_)))


def _interleaved(keys: Keys) -> Keys:
    """The bits of each key from the highest on, in groups of three, x in the lowest."""
    codes = np.zeros(len(keys), np.int64)
    for bit in range(_DEPTH):
        for axis in range(3):
            codes |= (keys[:, axis] >> bit & 1) << (3 * bit + axis)
    return codes
