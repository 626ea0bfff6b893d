"""glTF 2.0 and GLB: the meshes that the scene places, in metres.

The format fixes y as up; it is turned so that z is, as RViz of ROS 2 does (ros2/rviz pull request 1482).
"""

from __future__ import annotations

import base64
import binascii
import json
import struct
from collections.abc import Callable
from pathlib import PurePosixPath
from typing import Any
from urllib.parse import unquote_to_bytes

import numpy as np

from zarm_geometry.mesh_files.mesh_file import MeshFile, Unreadable, accounted, many
from zarm_geometry.mesh_files.polygons import fan, strip
from zarm_trajectory.arrays import Array

_MAGIC = b"glTF"
_NUMBERS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_MODES = ("points", "lines", "lines", "lines", "triangles", "strip", "fan")
_HARMLESS = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_", "KHR_mesh_quantization", "KHR_xmp")
"""Extensions that leave the geometry as it is, by their beginning."""
_COMPRESSED = ("KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression")
_UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""From y up to z up."""


def read(content: bytes, beside: Callable[[str], bytes] | None = None) -> MeshFile:
    """The triangles that the file's scene places; `beside` reads the files that it names. Raises Unreadable."""
    document, binary, notes = _chunks(content)
    file = _File(document, binary, beside, notes)
    try:
        triangles = file.triangles()
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise Unreadable(f"it breaks the rules of glTF at {error}; export it again") from error
    if not len(triangles):
        raise Unreadable("its scene places no triangles; export it again")
    return MeshFile(triangles @ _UPRIGHT.T, tuple(dict.fromkeys(notes)))


def _chunks(content: bytes) -> tuple[dict[str, Any], bytes | None, list[str]]:
    """The JSON, the binary chunk, and notes."""
    notes: list[str] = []
    text, binary = content, None
    if content.startswith(_MAGIC):
        if len(content) < 20:
            raise Unreadable("it is cut off; export it again")
        _, version, length = struct.unpack_from("<4sII", content)
        if version != 2:
            raise Unreadable(f"it is of version {version}; export it as glTF 2.0")
        if length > len(content):
            raise Unreadable(
                f"its header announces {length} bytes, and it has {len(content)}: it is cut off; export it again"
            )
        if length < len(content):
            notes.append(f"the {many(len(content) - length, 'byte')} after its end are not read")
        at, chunks = 12, dict[bytes, bytes]()
        while at + 8 <= length:
            size, kind = struct.unpack_from("<I4s", content, at)
            if at + 8 + size > length:
                raise Unreadable(f"its chunk {kind.decode('latin-1')!r} is longer than the file; export it again")
            chunks.setdefault(kind, content[at + 8 : at + 8 + size])
            at += 8 + size
        text, binary = chunks.get(b"JSON", b""), chunks.get(b"BIN\0")
    try:
        document = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise Unreadable(f"its JSON cannot be read: {error}; export it again") from error
    version = str(document.get("asset", {}).get("version", "")) if isinstance(document, dict) else ""
    if not version.startswith("2."):
        raise Unreadable("it is not glTF 2.0; export it as that")
    return document, binary, notes


class _File:
    def __init__(
        self, document: dict[str, Any], binary: bytes | None, beside: Callable[[str], bytes] | None, notes: list[str]
    ) -> None:
        self.document, self.binary, self.beside, self.notes = document, binary, beside, notes
        self.buffers: dict[int, bytes] = {}
        for name in document.get("extensionsRequired", ()):
            if not name.startswith(_HARMLESS):
                raise Unreadable(f"it requires the extension {name}, which is not known here; export it without")

    def triangles(self) -> Array:
        nodes = self.document.get("nodes", [])
        scenes = self.document.get("scenes", [])
        if scenes:
            roots = scenes[self.document.get("scene", 0)].get("nodes", [])
        else:
            below = {child for node in nodes for child in node.get("children", ())}
            roots = [at for at in range(len(nodes)) if at not in below]
        shapes: dict[int, Array] = {}
        seen: set[int] = set()
        found = [np.empty((0, 3, 3))]
        waiting = [(at, np.eye(4)) for at in roots]
        while waiting:
            at, pose = waiting.pop()
            node = nodes[at]
            if at in seen:
                raise Unreadable(f"the node {at} stands in two places, or within itself; export it again")
            seen.add(at)
            pose = pose @ _pose(node)
            waiting += [(child, pose) for child in node.get("children", ())]
            if "EXT_mesh_gpu_instancing" in node.get("extensions", {}):
                raise Unreadable(f"the node {at} is repeated by EXT_mesh_gpu_instancing; export it without")
            if "mesh" not in node:
                continue
            if "skin" in node:
                raise Unreadable(f"the node {at} is a mesh on a skeleton; apply its pose, and export it without")
            mesh = node["mesh"]
            if any(node.get("weights", self.document["meshes"][mesh].get("weights", ()))):
                raise Unreadable(f"the node {at} is a mesh with morph targets; apply them, and export it without")
            if mesh not in shapes:
                shapes[mesh] = self._shape(mesh)
            triangles = shapes[mesh] @ pose[:3, :3].T + pose[:3, 3]
            found.append(triangles[:, ::-1] if np.linalg.det(pose[:3, :3]) < 0.0 else triangles)
        lost = [at for at, node in enumerate(nodes) if at not in seen and "mesh" in node]
        if lost:
            self.notes.append(f"{many(len(lost), 'node')} with a mesh that its scene does not place are not taken")
        placed = {node["mesh"] for node in nodes if "mesh" in node}
        if spare := len(self.document.get("meshes", ())) - len(placed):
            self.notes.append(f"{many(spare, 'mesh', 'meshes')} that no node places are not taken")
        return np.concatenate(found)

    def _shape(self, mesh: int) -> Array:
        """The triangles (n, 3, 3) of a mesh in its own frame."""
        found = [np.empty((0, 3, 3))]
        for primitive in self.document["meshes"][mesh]["primitives"]:
            kind = _MODES[primitive.get("mode", 4)]
            if kind in ("points", "lines"):
                self.notes.append(f"the mesh {mesh} has {kind}, which no arm touches; they are not taken")
                continue
            place = primitive["attributes"].get("POSITION")
            accessors = self.document["accessors"]
            packed = [name for name in _COMPRESSED if name in primitive.get("extensions", {})]
            if packed and (place is None or "bufferView" not in accessors[place]):
                raise Unreadable(f"it is compressed with {packed[0]}; export it without")
            if place is None:
                self.notes.append(f"the mesh {mesh} has a primitive without positions; it is not taken")
                continue
            points = self._values(place)
            if points.shape[1] != 3:
                raise Unreadable(
                    f"the positions of the mesh {mesh} have {points.shape[1]} coordinates; export it again"
                )
            listed = primitive.get("indices")
            held = accessors[place if listed is None else listed]["count"]
            corners = np.arange(len(points)) if listed is None else self._values(listed)[:, 0].astype(np.int64)
            if len(corners) and corners.max() >= len(points):
                raise Unreadable(
                    f"the mesh {mesh} names the vertex {corners.max()}, and has {len(points)}; export it again"
                )
            if kind == "triangles":
                if held % 3:
                    raise Unreadable(f"the mesh {mesh} has {held} corners, which make no triangles; export it again")
                index, count = corners.reshape(-1, 3), held // 3
            else:
                index, count = (strip if kind == "strip" else fan)(corners), max(0, held - 2)
            accounted(f"triangles of the mesh {mesh}", count, len(index))
            found.append(points[index])
        return np.concatenate(found)

    def _values(self, at: int) -> Array:
        """The values (count, width) of an accessor."""
        accessor = self.document["accessors"][at]
        kind, count, width = accessor["componentType"], accessor["count"], _WIDTHS[accessor["type"]]
        if count < 0:
            raise Unreadable(f"the accessor {at} has a negative count; export it again")
        if "bufferView" in accessor:
            found = self._viewed(accessor["bufferView"], accessor.get("byteOffset", 0), kind, count, width)
        else:
            if "sparse" not in accessor:
                raise Unreadable(f"the accessor {at} has no values: an extension holds them; export it without")
            found = np.zeros((count, width))
        if "sparse" in accessor:
            sparse = accessor["sparse"]
            where, what = sparse["indices"], sparse["values"]
            rows = self._viewed(
                where["bufferView"], where.get("byteOffset", 0), where["componentType"], sparse["count"], 1
            )
            found[rows[:, 0].astype(np.int64)] = self._viewed(
                what["bufferView"], what.get("byteOffset", 0), kind, sparse["count"], width
            )
        if accessor.get("normalized"):
            most = float(np.iinfo(np.dtype(_NUMBERS[kind])).max)
            found = np.maximum(found / most, -1.0)
        return found

    def _viewed(self, view: int, offset: int, kind: int, count: int, width: int) -> Array:
        about = self.document["bufferViews"][view]
        if packed := [name for name in _COMPRESSED if name in about.get("extensions", {})]:
            raise Unreadable(f"it is compressed with {packed[0]}; export it without")
        number = np.dtype(_NUMBERS[kind])
        stride = about.get("byteStride", number.itemsize * width)
        start, end = about.get("byteOffset", 0) + offset, about.get("byteOffset", 0) + about["byteLength"]
        data = self._buffer(about["buffer"])
        need = start + (count - 1) * stride + width * number.itemsize if count else start
        if need > min(end, len(data)) or min(start, offset, stride) < 0:
            raise Unreadable(
                f"the buffer view {view} holds fewer values than are announced: it is cut off; export it again"
            )
        if not count:
            return np.empty((0, width))
        return np.ndarray((count, width), number, data, start, (stride, number.itemsize)).astype(np.float64)

    def _buffer(self, at: int) -> bytes:
        if at not in self.buffers:
            self.buffers[at] = self._loaded(at, self.document["buffers"][at])
        return self.buffers[at]

    def _loaded(self, at: int, about: dict[str, Any]) -> bytes:
        uri = about.get("uri")
        if uri is None:
            if at or self.binary is None:
                raise Unreadable(f"its buffer {at} has no data; export it again")
            data = self.binary
        elif uri.startswith("data:"):
            head, _, body = uri.partition(",")
            try:
                data = base64.b64decode(body, validate=True) if head.endswith(";base64") else unquote_to_bytes(body)
            except binascii.Error as error:
                raise Unreadable(f"its buffer {at} is no base64: {error}; export it again") from error
        else:
            data = self._beside(unquote_to_bytes(uri).decode("utf-8", "replace"))
        if len(data) < about["byteLength"]:
            raise Unreadable(
                f"its buffer {at} has {len(data)} of {about['byteLength']} bytes: it is cut off; export it again"
            )
        return data

    def _beside(self, name: str) -> bytes:
        path = PurePosixPath(name)
        if self.beside is None or "://" in name or path.is_absolute() or ".." in path.parts:
            raise Unreadable(f"it names the file {name}, which is not read from there; export it as .glb")
        try:
            return self.beside(name)
        except (OSError, ValueError) as error:
            raise Unreadable(f"it names the file {name}, which cannot be read; put it beside") from error


def _pose(node: dict[str, Any]) -> Array:
    """A node's transform (4, 4)."""
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    x, y, z, w = node.get("rotation", (0.0, 0.0, 0.0, 1.0))
    pose = np.eye(4)
    pose[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    pose[:3, :3] *= np.array(node.get("scale", (1.0, 1.0, 1.0)))
    pose[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return pose
