"""Collision objects of MoveIt as objects of the scene, and back.

A collision object may have several shapes, an object of the scene has one: those of `shelf` are `shelf..0`, `shelf..1` and so on.
"""

from __future__ import annotations

import math
import re
from base64 import b64decode, b64encode
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from geometry_msgs.msg import Point
from moveit_msgs.msg import CollisionObject
from moveit_msgs.msg import MoveItErrorCodes as Val
from shape_msgs.msg import Mesh as RosMesh
from shape_msgs.msg import MeshTriangle, SolidPrimitive

from zarm_contract.messages import (
    Capsule,
    Cuboid,
    Cylinder,
    Mesh,
    Pose,
    Quaternion,
    SceneObject,
    Sphere,
    Vector3,
    Voxels,
)
from zarm_geometry import mesh_files
from zarm_geometry.frames import matrix, pose_of, rotation_to
from zarm_ros_bridge.convert.fields import finite
from zarm_ros_bridge.convert.poses import pose_of as ros_pose_of
from zarm_ros_bridge.convert.poses import ros_pose
from zarm_ros_bridge.frames import placed
from zarm_ros_bridge.moveit.error_codes import Refusal
from zarm_trajectory.arrays import Array

SLAB = 20.0, 0.02
"""Edge and thickness (m) of the slab that stands for a plane, below it."""
MOST_CUBES = 5000
"""Most cells of voxels that are shown as boxes."""
MOST_TRIANGLES = 50_000
"""Most triangles of a mesh."""
_FACETS = 32
"""Sides of the pyramid around a cone: 0.5 % wider than the cone at most."""
_NOT_A_NAME = re.compile(r"[^A-Za-z0-9_.-]")
_PART = re.compile(r"(?P<id>.+)\.\.[0-9]+")


def name_of(identity: str, field: str = "id") -> str:
    """The name in the scene for an id: characters that a name cannot have become `_`. Raises Refusal for an empty or long id."""
    name = _NOT_A_NAME.sub("_", identity)
    if not 0 < len(name) <= 60 or _PART.fullmatch(name):
        raise Refusal(
            Val.INVALID_OBJECT_NAME,
            f"{identity[:80]!r}: an id has 1 to 60 characters, and does not end with .. and a number",
            field,
        )
    return name


def id_of(name: str) -> str:
    """The id of the collision object that an object of the scene belongs to."""
    found = _PART.fullmatch(name)
    return name if found is None else found["id"]


def parts_of(message: Any, name: str, frame: Array | None, field: str) -> tuple[SceneObject, ...]:
    """The shapes of a collision object in the base frame; `frame` (4, 4) is where its header's frame is, None for the base frame.

    Raises Refusal.
    """
    origin = origin_of(message, frame, field)
    shapes: list[tuple[_Shape, Array]] = []
    for i, shape in enumerate(message.primitives):
        made = _solid(shape, f"{field}.primitives[{i}]")
        shapes.append((made, _pose(message.primitive_poses, i, f"{field}.primitive_poses")))
    for i, plane in enumerate(message.planes):
        slab, offset = _plane(plane, f"{field}.planes[{i}]")
        shapes.append((slab, _pose(message.plane_poses, i, f"{field}.plane_poses") @ offset))
    for i, mesh in enumerate(message.meshes):
        made = _triangles(mesh, f"{field}.meshes[{i}]")
        shapes.append((made, _pose(message.mesh_poses, i, f"{field}.mesh_poses")))
    if not shapes:
        raise Refusal(Val.INVALID_OBJECT_NAME, "the object has no shape; give it a primitive", f"{field}.primitives")
    several = len(shapes) > 1
    return tuple(
        _named(shape, f"{name}..{i}" if several else name, origin @ own) for i, (shape, own) in enumerate(shapes)
    )


def origin_of(message: Any, frame: Array | None, field: str) -> Array:
    """The pose (4, 4) of a collision object in the base frame. Raises InvalidRequest."""
    pose = ros_pose_of(message.pose, f"{field}.pose")
    own = matrix(pose.position, pose.orientation)
    return own if frame is None else frame @ own


def moved(part: SceneObject, by: Array) -> SceneObject:
    """The same object where `by` (4, 4), in the base frame, moves it."""
    pose = pose_of(by @ placed(part))
    if isinstance(part, Sphere):
        return part.model_copy(update={"position": pose.position})
    return part.model_copy(update={"position": pose.position, "orientation": pose.orientation})


def collision_object(identity: str, parts: Sequence[SceneObject], origin: Array, frame: str) -> Any:
    """The message for the parts of an object with its own pose `origin` (4, 4), both in `frame`."""
    message = CollisionObject(id=identity, pose=ros_pose(pose_of(origin)), operation=CollisionObject.ADD)
    message.header.frame_id = frame
    into = np.linalg.inv(origin)
    for part in parts:
        if isinstance(part, Mesh) and part.data is not None:
            message.meshes.append(_ros_mesh(part))
            message.mesh_poses.append(ros_pose(pose_of(into @ placed(part))))
        for kind, sizes, offset in _solids(part):
            message.primitives.append(SolidPrimitive(type=kind, dimensions=sizes))
            message.primitive_poses.append(ros_pose(pose_of(into @ placed(part) @ offset)))
    return message


@dataclass(frozen=True)
class _Shape:
    """A primitive: its type and sizes (m); or the `triangles` (n, 3, 3) of a mesh (m)."""

    kind: int
    sizes: tuple[float, ...]
    triangles: Array | None = None


def _solid(primitive: Any, field: str) -> _Shape:
    counts = {SolidPrimitive.BOX: 3, SolidPrimitive.SPHERE: 1, SolidPrimitive.CYLINDER: 2, SolidPrimitive.CONE: 2}
    sizes = tuple(finite(size, f"{field}.dimensions[{i}]") for i, size in enumerate(primitive.dimensions))
    if counts.get(primitive.type) != len(sizes) or min(sizes) <= 0.0:
        raise Refusal(
            Val.INVALID_OBJECT_NAME,
            f"{len(sizes)} dimensions {sizes} are not those of the type {primitive.type}; give BOX 3, SPHERE 1, CYLINDER 2 "
            "or CONE 2, all above 0",
            f"{field}.dimensions",
        )
    return _Shape(primitive.type, sizes, _cone(*sizes) if primitive.type == SolidPrimitive.CONE else None)


def _cone(height: float, radius: float) -> Array:
    """Triangles around a cone whose centre is half-way up, its tip above."""
    turns = np.arange(_FACETS) * 2.0 * np.pi / _FACETS
    outer = radius / math.cos(math.pi / _FACETS)
    rim = np.column_stack((outer * np.cos(turns), outer * np.sin(turns), np.full(_FACETS, -height / 2.0)))
    following = np.roll(rim, -1, axis=0)
    tip, middle = (np.tile((0.0, 0.0, z), (_FACETS, 1)) for z in (height / 2.0, -height / 2.0))
    return np.concatenate((np.stack((rim, following, tip), axis=1), np.stack((following, rim, middle), axis=1)))


def _triangles(mesh: Any, field: str) -> _Shape:
    vertices = np.array([(one.x, one.y, one.z) for one in mesh.vertices], np.float64).reshape(-1, 3)
    faces = np.array([one.vertex_indices for one in mesh.triangles], np.int64).reshape(-1, 3)
    if not len(faces) or not np.isfinite(vertices).all() or faces.max() >= len(vertices):
        raise Refusal(
            Val.INVALID_OBJECT_NAME,
            f"{len(faces)} triangles of {len(vertices)} vertices: give some, of vertices that exist and are finite numbers",
            field,
        )
    if len(faces) > MOST_TRIANGLES:
        raise Refusal(
            Val.INVALID_OBJECT_NAME,
            f"{len(faces)} triangles are more than {MOST_TRIANGLES}; simplify the mesh, or put its file into a mesh folder of "
            "the planner",
            f"{field}.triangles",
        )
    return _Shape(-1, (), vertices[faces])


def _stl(triangles: Array) -> str:
    """Triangles as a binary STL file, in base64."""
    records = np.zeros(
        len(triangles), np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    )
    records["corners"] = triangles
    return b64encode(bytes(80) + len(triangles).to_bytes(4, "little") + records.tobytes()).decode()


def _plane(plane: Any, field: str) -> tuple[_Shape, Array]:
    """The slab below the plane ax + by + cz + d = 0, whose normal points up."""
    a, b, c, d = (finite(value, f"{field}.coef[{i}]") for i, value in enumerate(plane.coef))
    length = float(np.linalg.norm((a, b, c)))
    if length < 1e-9:
        raise Refusal(Val.INVALID_OBJECT_NAME, "the plane has no normal", f"{field}.coef")
    offset = np.eye(4)
    offset[:3, :3] = rotation_to((a / length, b / length, c / length))
    offset[:3, 3] = offset[:3, 2] * (-d / length - SLAB[1] / 2.0)
    return _Shape(SolidPrimitive.BOX, (SLAB[0], SLAB[0], SLAB[1])), offset


def _pose(poses: Sequence[Any], i: int, field: str) -> Array:
    if i >= len(poses):
        return np.eye(4)
    pose = ros_pose_of(poses[i], f"{field}[{i}]")
    return matrix(pose.position, pose.orientation)


def _named(shape: _Shape, name: str, at: Array) -> SceneObject:
    pose: Pose = pose_of(at)
    position: Vector3 = pose.position
    turned: Quaternion = pose.orientation
    if shape.triangles is not None:
        return Mesh(
            kind="mesh",
            name=name,
            position=position,
            orientation=turned,
            file=f"{name}.stl",
            data=_stl(shape.triangles),
        )
    if shape.kind == SolidPrimitive.SPHERE:
        return Sphere(kind="sphere", name=name, position=position, radius=shape.sizes[0])
    if shape.kind == SolidPrimitive.BOX:
        x, y, z = shape.sizes
        return Cuboid(kind="cuboid", name=name, position=position, orientation=turned, size=(x, y, z))
    height, radius = shape.sizes
    return Cylinder(kind="cylinder", name=name, position=position, orientation=turned, radius=radius, length=height)


def _solids(part: SceneObject) -> Iterator[tuple[int, list[float], Array]]:
    """The primitives that show an object: type, sizes (m) and pose in its frame."""
    match part:
        case Cuboid():
            yield SolidPrimitive.BOX, list(part.size), np.eye(4)
        case Sphere():
            yield SolidPrimitive.SPHERE, [part.radius], np.eye(4)
        case Cylinder():
            yield SolidPrimitive.CYLINDER, [part.length, part.radius], np.eye(4)
        case Capsule():
            yield SolidPrimitive.CYLINDER, [part.length, part.radius], np.eye(4)
            for side in (-0.5, 0.5):
                yield SolidPrimitive.SPHERE, [part.radius], matrix((0.0, 0.0, side * part.length))
        case Voxels():
            edge = part.resolution
            for i, j, k in part.cells[:MOST_CUBES]:
                yield SolidPrimitive.BOX, [edge] * 3, matrix((i * edge, j * edge, k * edge))
        case Mesh():  # its triangles, or a file that the planner alone has
            return


def _ros_mesh(part: Mesh) -> Any:
    """The scaled triangles of a mesh whose message contains the file."""
    read = mesh_files.read(part.file, b64decode(part.data or ""))
    vertices, faces = np.unique((read.triangles * part.scale).reshape(-1, 3).round(9), axis=0, return_inverse=True)
    return RosMesh(
        vertices=[Point(x=x, y=y, z=z) for x, y, z in vertices.tolist()],
        triangles=[MeshTriangle(vertex_indices=corners) for corners in faces.reshape(-1, 3).tolist()],
    )
