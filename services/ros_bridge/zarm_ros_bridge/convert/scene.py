"""Objects of the scene and occupied voxels, from and to ROS."""

from __future__ import annotations

import re

import numpy as np
from geometry_msgs.msg import Vector3 as RosVector3
from sensor_msgs.msg import PointCloud2, PointField

from curobo_msgs.srv import AddObject
from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import Capsule, Cuboid, Cylinder, Mesh, Occupancy, SceneObject, Sphere, Vector3
from zarm_ros_bridge.convert.fields import finite
from zarm_ros_bridge.convert.poses import pose_of

_NAME = re.compile(r"[A-Za-z0-9_.-]{1,64}")


def object_of(request: AddObject.Request) -> SceneObject:
    """The object that a request describes. Raises InvalidRequest.

    `dimensions` are m: the full extents of a cuboid; in x the radius of a sphere, capsule or cylinder, and in z the length of
    the last two (of a capsule between the centres of its ends); the scale of a mesh, where all zeros are 1.
    """
    name, pose, d = name_of(request.name), pose_of(request.pose, "pose"), request.dimensions
    at, turned = pose.position, pose.orientation
    match request.type:
        case AddObject.Request.CUBOID:
            return Cuboid(kind="cuboid", name=name, position=at, orientation=turned, size=_sizes(d))
        case AddObject.Request.SPHERE:
            return Sphere(kind="sphere", name=name, position=at, radius=_size(d.x, "x"))
        case AddObject.Request.CAPSULE:
            radius, length = _size(d.x, "x"), _size(d.z, "z")
            return Capsule(kind="capsule", name=name, position=at, orientation=turned, radius=radius, length=length)
        case AddObject.Request.CYLINDER:
            radius, length = _size(d.x, "x"), _size(d.z, "z")
            return Cylinder(kind="cylinder", name=name, position=at, orientation=turned, radius=radius, length=length)
        case AddObject.Request.MESH:
            scale = _sizes(d) if any((d.x, d.y, d.z)) else (1.0, 1.0, 1.0)
            file = _file(request.mesh_file_path)
            return Mesh(kind="mesh", name=name, position=at, orientation=turned, file=file, scale=scale)
    raise InvalidRequest(
        f"{request.type} is not a type of object; use CUBOID 0, SPHERE 1, CAPSULE 2, CYLINDER 3 or MESH 4", field="type"
    )


def name_of(name: str) -> str:
    """The name of an object of the scene. Raises InvalidRequest."""
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
"""Fields of an edit that adds one object, and what they are in AddObject."""


def ros_cloud(occupancy: Occupancy, frame: str) -> PointCloud2:
    """The centres of occupied voxels as points x, y, z (float32, m) in `frame`."""
    centres = np.array(occupancy.cells, np.float64).reshape(-1, 3) * occupancy.resolution
    message = PointCloud2(
        height=1,
        width=len(centres),
        fields=[
            PointField(name=axis, offset=4 * i, datatype=PointField.FLOAT32, count=1) for i, axis in enumerate("xyz")
        ],
        point_step=12,
        row_step=12 * len(centres),
        is_dense=True,
        data=centres.astype("<f4").tobytes(),
    )
    message.header.frame_id = frame
    return message


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
