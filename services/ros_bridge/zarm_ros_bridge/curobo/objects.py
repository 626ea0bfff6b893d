"""Converts objects of the scene and occupied voxels."""

from __future__ import annotations

import math
import re
from array import array
from typing import TYPE_CHECKING

import numpy as np
from geometry_msgs.msg import Vector3 as RosVector3

from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import Capsule, Cuboid, Cylinder, Mesh, Occupancy, SceneObject, Sphere, Vector3
from zarm_ros_bridge.convert.fields import finite
from zarm_ros_bridge.convert.poses import pose_of

if TYPE_CHECKING:
    from nav2_msgs.msg import VoxelGrid

    from curobo_msgs.srv import AddObject

MOST_VOXELS = 4_000_000
"""Most voxels in one box; its message has four times as many bytes."""
_NAME = re.compile(r"[A-Za-z0-9_.-]{1,64}")


def object_of(request: AddObject.Request) -> SceneObject:
    """The object that a request describes. Raises InvalidRequest.

    `dimensions` are in m: the full extents of a cuboid; for a sphere, capsule or cylinder the radius in x, and for the
    last two the length in z (of a capsule between the centres of its ends); for a mesh the scale, where all zeros mean
    1.
    """
    name, pose, d = name_of(request.name), pose_of(request.pose, "pose"), request.dimensions
    at, turned = pose.position, pose.orientation
    match request.type:
        case request.CUBOID:
            return Cuboid(kind="cuboid", name=name, position=at, orientation=turned, size=_sizes(d))
        case request.SPHERE:
            return Sphere(kind="sphere", name=name, position=at, radius=_size(d.x, "x"))
        case request.CAPSULE:
            radius, length = _size(d.x, "x"), _size(d.z, "z")
            return Capsule(kind="capsule", name=name, position=at, orientation=turned, radius=radius, length=length)
        case request.CYLINDER:
            radius, length = _size(d.x, "x"), _size(d.z, "z")
            return Cylinder(kind="cylinder", name=name, position=at, orientation=turned, radius=radius, length=length)
        case request.MESH:
            scale = _sizes(d) if any((d.x, d.y, d.z)) else (1.0, 1.0, 1.0)
            file = _file(request.mesh_file_path)
            return Mesh(kind="mesh", name=name, position=at, orientation=turned, file=file, scale=scale)
    raise InvalidRequest(
        f"{request.type} is not a type of object; use CUBOID 0, SPHERE 1, CAPSULE 2, CYLINDER 3 or MESH 4", field="type"
    )


def name_of(name: str) -> str:
    """The name of a scene object. Raises InvalidRequest."""
    if not _NAME.fullmatch(name):
        raise InvalidRequest(f"{name!r}: a name is 1 to 64 letters, digits, _, . and -", field="name")
    return name


FIELDS = {
    "edit.objects.0.name": "name",
    "edit.objects.0.file": "mesh_file_path",
    "edit.objects.0.position": "pose.position",
    "edit.objects.0.radius": "dimensions.x",
    "edit.objects.0.length": "dimensions.z",
    **{
        f"edit.objects.0.{size}.{i}": f"dimensions.{axis}" for size in ("size", "scale") for i, axis in enumerate("xyz")
    },
}
"""Fields of an edit that adds one object, and their names in AddObject."""


Corners = tuple[tuple[float, ...], tuple[float, ...]]


def fill_grid(grid: VoxelGrid, occupancy: Occupancy, frame: str, box: Corners | None) -> None:
    """The voxels of a box (corners in m; None: the smallest that contains all occupied ones) as 0 and 1, with the index
    of x the slowest.

    The box is widened to whole voxels; `origin` is its corner with the lowest coordinates. Raises InvalidRequest if it
    has more than MOST_VOXELS.
    """
    edge = occupancy.resolution
    cells = np.array(occupancy.cells, np.int64).reshape(-1, 3)  # cell i extends from i - 1/2 to i + 1/2
    if box is not None:
        low, high = (np.array(corner) / edge for corner in box)
        first, last = np.floor(low + 0.5).astype(int), np.ceil(high - 0.5).astype(int)
        cells = cells[np.all((cells >= first) & (cells <= last), axis=1)]
    elif len(cells):
        first, last = cells.min(axis=0), cells.max(axis=0)
    else:
        first, last = np.zeros(3, int), np.full(3, -1)
    shape = last - first + 1
    if (count := math.prod(shape.tolist())) > MOST_VOXELS:
        raise InvalidRequest(
            f"the box has {count} voxels, which are more than {MOST_VOXELS}; ask for a smaller one, or set a larger voxel_size",
            field="voxel_size",
        )
    occupied = np.zeros(shape, np.uint32)
    occupied[tuple((cells - first).T)] = 1
    grid.header.frame_id = frame
    grid.data = array("I", occupied.tobytes())
    grid.origin.x, grid.origin.y, grid.origin.z = ((first - 0.5) * edge).tolist()
    grid.resolutions = RosVector3(x=edge, y=edge, z=edge)
    grid.size_x, grid.size_y, grid.size_z = shape.tolist()


def _sizes(dimensions: RosVector3) -> Vector3:
    return _size(dimensions.x, "x"), _size(dimensions.y, "y"), _size(dimensions.z, "z")


def _size(value: float, axis: str) -> float:
    field = f"dimensions.{axis}"
    if finite(value, field) <= 0.0:
        raise InvalidRequest(f"{value:g} is not a size; give one above 0, in m", field=field)
    return value


def _file(path: str) -> str:
    if not 0 < len(path) <= 255:
        raise InvalidRequest(
            "give the path of an .stl or .obj file in a mesh folder of the planner, in 1 to 255 characters",
            field="mesh_file_path",
        )
    return path
