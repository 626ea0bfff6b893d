"""MoveIt's text of a planning scene's objects: the `.scene` files of RViz and `save_geometry_to_file`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from geometry_msgs.msg import Point, Pose, Quaternion
from moveit_msgs.msg import CollisionObject
from moveit_msgs.msg import MoveItErrorCodes as Val
from shape_msgs.msg import Mesh, MeshTriangle, Plane, SolidPrimitive

from zarm_ros_bridge.moveit.error_codes import Refusal

_SIZES = {
    "box": (SolidPrimitive.BOX, 3),
    "sphere": (SolidPrimitive.SPHERE, 1),
    "cylinder": (SolidPrimitive.CYLINDER, 2),
    "cone": (SolidPrimitive.CONE, 2),
}
"""Type and number of sizes by name; of a cylinder and a cone the text has the radius first, the message the height."""
_ROUND = (SolidPrimitive.CYLINDER, SolidPrimitive.CONE)


def text_of(name: str, objects: Sequence[Any], colours: dict[str, tuple[float, float, float, float]]) -> str:
    """The text of `moveit_msgs/CollisionObject`s, in the planning frame."""
    return "\n".join([name or "(noname)", *(line for item in objects for line in _lines(item, colours)), ".", ""])


def objects_of(text: str, frame: str) -> list[Any]:
    """The collision objects of a text, in `frame`. Raises Refusal that names the line."""
    reader = _Reader(text.splitlines())
    reader.next()  # the name of the scene
    objects = []
    while (line := reader.next()) != ".":
        if not line.startswith("*"):
            raise reader.refusal("an object begins with `* id`, and the text ends with `.`")
        objects.append(_object(line[1:].strip(), reader, frame))
    return objects


def _lines(item: Any, colours: dict[str, tuple[float, float, float, float]]) -> Iterator[str]:
    yield f"* {item.id}"
    yield from _pose_lines(item.pose)
    yield str(len(item.primitives) + len(item.meshes))
    colour = " ".join(map(repr, colours.get(item.id, (0, 0, 0, 0))))
    names = {kind: name for name, (kind, _) in _SIZES.items()}
    for shape, pose in zip(item.primitives, item.primitive_poses, strict=True):
        sizes = list(shape.dimensions)
        yield names[shape.type]
        yield " ".join(map(repr, reversed(sizes) if shape.type in _ROUND else sizes))
        yield from _pose_lines(pose)
        yield colour
    for mesh, pose in zip(item.meshes, item.mesh_poses, strict=True):
        yield "mesh"
        yield f"{len(mesh.vertices)} {len(mesh.triangles)}"
        yield from (f"{one.x!r} {one.y!r} {one.z!r}" for one in mesh.vertices)
        yield from (" ".join(map(str, one.vertex_indices)) for one in mesh.triangles)
        yield from _pose_lines(pose)
        yield colour
    yield "0"


def _pose_lines(pose: Any) -> Iterator[str]:
    p, q = pose.position, pose.orientation
    yield f"{p.x!r} {p.y!r} {p.z!r}"
    yield f"{q.x!r} {q.y!r} {q.z!r} {q.w!r}"


class _Reader:
    """The lines of a text that are not empty, one after the other."""

    def __init__(self, lines: Sequence[str]) -> None:
        self._lines = [(number, line.strip()) for number, line in enumerate(lines, start=1) if line.strip()]
        self._next = 0

    def next(self) -> str:
        """The next line."""
        if self._next == len(self._lines):
            raise self.refusal("the text ends early")
        self._next += 1
        return self._lines[self._next - 1][1]

    def numbers(self, *counts: int) -> list[float]:
        """The numbers of the next line, as many as one of `counts`."""
        line = self.next()
        try:
            values = list(map(float, line.split()))
        except ValueError as error:
            raise self.refusal(f"{line[:60]!r} are not numbers") from error
        if len(values) not in counts:
            raise self.refusal(f"{len(values)} numbers where {' or '.join(map(str, counts))} belong")
        return values

    def refusal(self, message: str) -> Refusal:
        """An error at the line that was read last."""
        number = self._lines[self._next - 1][0] if self._next else 0
        return Refusal(Val.INVALID_OBJECT_NAME, f"line {number}: {message}", "file_path_and_name")


def _object(identity: str, reader: _Reader, frame: str) -> Any:
    item = CollisionObject(id=identity, operation=CollisionObject.ADD)
    item.header.frame_id = frame
    first = reader.numbers(1, 3)
    whole = len(first) == 3  # else the text of an earlier MoveIt, without the pose of the object and without subframes
    item.pose = _pose(first, reader.numbers(4)) if whole else Pose(orientation=Quaternion(w=1.0))
    count = reader.numbers(1)[0] if whole else first[0]
    for _ in range(int(count)):
        _shape(item, reader)
        reader.numbers(4)  # the colour
    if whole:
        for _ in range(int(reader.numbers(1)[0])):
            reader.next()  # the name of a subframe
            _pose(reader.numbers(3), reader.numbers(4))
    return item


def _shape(item: Any, reader: _Reader) -> None:
    kind = reader.next()
    if kind in _SIZES:
        number, count = _SIZES[kind]
        sizes = reader.numbers(count)
        item.primitives.append(SolidPrimitive(type=number, dimensions=sizes[::-1] if number in _ROUND else sizes))
        poses = item.primitive_poses
    elif kind == "mesh":
        vertices, triangles = map(int, reader.numbers(2))
        corners = [reader.numbers(3) for _ in range(vertices)]
        faces = [list(map(int, reader.numbers(3))) for _ in range(triangles)]
        item.meshes.append(
            Mesh(
                vertices=[Point(x=x, y=y, z=z) for x, y, z in corners],
                triangles=[MeshTriangle(vertex_indices=face) for face in faces],
            )
        )
        poses = item.mesh_poses
    elif kind == "plane":
        item.planes.append(Plane(coef=reader.numbers(4)))
        poses = item.plane_poses
    else:
        raise reader.refusal(f"{kind[:60]!r} is no shape; known are {', '.join((*_SIZES, 'mesh', 'plane'))}")
    poses.append(_pose(reader.numbers(3), reader.numbers(4)))


def _pose(position: Sequence[float], orientation: Sequence[float]) -> Any:
    (px, py, pz), (x, y, z, w) = position, orientation
    return Pose(position=Point(x=px, y=py, z=pz), orientation=Quaternion(x=x, y=y, z=z, w=w))
