"""Random mesh files in every format, as exporters and people write them, with the surface that they hold."""

from __future__ import annotations

import json
import random
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from zarm_trajectory.arrays import Array

Face = tuple[int, ...]


@dataclass(frozen=True)
class Surface:
    """What a triangulated surface has, however its polygons are cut: count, bounds (2, 3), the sum of the triangles'
    area vectors and the sum of their lengths (m^2), and the volume (m^3), which is negative if it is wound inwards.
    """

    count: int
    bounds: Array
    area: Array
    volume: float

    @classmethod
    def of(cls, triangles: Array) -> Surface:
        a, b, c = triangles.transpose(1, 0, 2)
        normals = np.cross(b - a, c - a) / 2
        volume = float(np.einsum("ni,ni->", a, np.cross(b, c)) / 6)
        corners = triangles.reshape(-1, 3)
        lengths = np.linalg.norm(normals, axis=1).sum()
        return cls(
            len(triangles), np.stack((corners.min(0), corners.max(0))), np.append(normals.sum(0), lengths), volume
        )

    def assert_same(self, other: Surface, precision: float) -> None:
        size = float(np.abs(self.bounds).max())
        assert other.count == self.count
        np.testing.assert_allclose(other.bounds, self.bounds, atol=precision * size)
        np.testing.assert_allclose(other.area, self.area, atol=precision * size**2 * self.count)
        assert abs(other.volume - self.volume) <= precision * size**3 * self.count


@dataclass(frozen=True)
class Piece:
    """A closed surface: vertices (n, 3), and polygons wound outwards."""

    vertices: Array
    faces: tuple[Face, ...]

    def moved(self, pose: Array) -> Piece:
        faces = self.faces if np.linalg.det(pose[:3, :3]) > 0 else tuple((face[0], *face[:0:-1]) for face in self.faces)
        return Piece(self.vertices @ pose[:3, :3].T + pose[:3, 3], faces)

    @property
    def triangles(self) -> Array:
        """Cut into fans; concave ones overlap, which changes neither the sum of area vectors nor the volume."""
        fans = [(face[0], face[k], face[k + 1]) for face in self.faces for k in range(1, len(face) - 1)]
        triangles: Array = self.vertices[np.array(fans)]
        return triangles

    @property
    def cut(self) -> Piece:
        """With every polygon cut into triangles without overlap; a concave one is an L, whose first corner sees all."""
        return Piece(self.vertices, tuple((f[0], f[k], f[k + 1]) for f in self.faces for k in range(1, len(f) - 1)))


def prism(rng: random.Random) -> Piece:
    """A box, a prism on a regular polygon, or one on an L, of multiples of 1/64 m somewhere in space."""

    def grid(low: int, high: int) -> float:
        return rng.randint(low, high) / 64

    kind = rng.choice(("box", "regular", "L"))
    if kind == "L":
        a, b = grid(16, 40), grid(16, 40)
        # The inner corner comes first: from there the whole polygon is seen.
        outline = [(a / 2, b / 2), (a / 2, b), (0.0, b), (0.0, 0.0), (a, 0.0), (a, b / 2)]
    elif kind == "box":
        a, b = grid(8, 40), grid(8, 40)
        outline = [(0.0, 0.0), (a, 0.0), (a, b), (0.0, b)]
    else:
        count = rng.randint(3, 9)
        turn = 2 * np.pi * np.arange(count) / count
        outline = [tuple(np.round(64 * grid(8, 40) * v) / 64) for v in np.stack((np.cos(turn), np.sin(turn)), 1)][
            :0
        ] or [(float(x), float(y)) for x, y in np.round(32 * np.stack((np.cos(turn), np.sin(turn)), 1)) / 64]
    n, height = len(outline), grid(8, 40)
    vertices = [(*xy, z) for z in (0.0, height) for xy in outline]
    sides = [(k, (k + 1) % n, n + (k + 1) % n, n + k) for k in range(n)]
    # Round the first corner both ways, so that a fan sees the whole polygon of the bottom too.
    bottom, top = (0, *range(n - 1, 0, -1)), tuple(range(n, 2 * n))
    at = np.array([grid(-64, 64) for _ in range(3)])
    return Piece(np.array(vertices) + at, (bottom, top, *sides))


def pieces(rng: random.Random) -> list[Piece]:
    return [prism(rng) for _ in range(rng.randint(1, 3))]


def every(found: Sequence[Piece]) -> Surface:
    """The surface of all pieces."""
    return Surface.of(np.concatenate([piece.triangles for piece in found]))


def number(rng: random.Random, value: float) -> str:
    """A number as one of the many ways to write it."""
    return rng.choice((repr, "{:.8f}".format, "{:+.9e}".format, "{:.10g}".format, "{:.9E}".format))(float(value))


def numbers(rng: random.Random, values: Sequence[float] | Array) -> str:
    return rng.choice((" ", "  ", "\t")).join(number(rng, value) for value in values)


def ended(rng: random.Random, text: str) -> bytes:
    """The text with any line ends."""
    return text.replace("\n", rng.choice(("\n", "\r\n"))).encode()


def stl_text(rng: random.Random) -> tuple[bytes, Surface]:
    found = [piece.cut for piece in pieces(rng)]
    upper = rng.random() < 0.2
    lines = []
    for piece in found:
        name = rng.choice(("", " part", " a facet of it", " Ünï", " solid", " exported by x"))
        lines.append(f"solid{name}")
        for face in piece.faces:
            lines += [f"  facet normal {numbers(rng, (0, 0, 1))}", "    outer loop"]
            lines += [f"      vertex {numbers(rng, piece.vertices[corner])}" for corner in face]
            lines += ["    endloop", "  endfacet"]
        lines.append(f"endsolid{name}")
    text = "\n".join(lines) + rng.choice(("\n", "", "\n\n"))
    return ended(rng, text.upper() if upper else text), every(found)


def stl_binary(rng: random.Random) -> tuple[bytes, Surface]:
    found = pieces(rng)
    triangles = np.concatenate([piece.cut.triangles for piece in found])
    start = rng.choice((b"", b"solid of a binary file", b"\xff\xfe", b"exported"))
    body = b"".join(struct.pack("<12fH", 0, 0, 1, *one.ravel(), rng.choice((0, 7))) for one in triangles)
    return start.ljust(80, rng.choice((b" ", b"\0"))) + struct.pack("<I", len(triangles)) + body, every(found)


def obj(rng: random.Random) -> tuple[bytes, Surface]:
    found = pieces(rng)
    lines = [rng.choice(("# made by hand", "mtllib no_such.mtl", ""))]
    blocks = rng.random() < 0.6
    count = 0
    faces: list[str] = []
    for k, piece in enumerate(found):
        if rng.random() < 0.5:
            lines.append(rng.choice((f"o part_{k}", f"g group_{k} all", f"usemtl m{k}", "s off", "s 1", "# a comment")))
        lines += [f"v {numbers(rng, vertex)}" for vertex in piece.vertices]
        if textured := rng.random() < 0.3:
            lines += ["vt 0.5 0.5"] * len(piece.vertices)
        negative = blocks and rng.random() < 0.5
        n = len(piece.vertices)
        written = []
        for face in piece.faces:
            names = [i - n if negative else count + i + 1 for i in face]
            ends = ["/" + str(-1) if textured else rng.choice(("", "", "")) for _ in face]
            row = "f " + " ".join(f"{name}{end}" for name, end in zip(names, ends, strict=True))
            if rng.random() < 0.05:
                row = row.replace(" ", " \\\n ", 1) if rng.random() < 0.5 else row + "  # a face"
            written.append(row)
        count += n
        if blocks:
            lines += written
        else:
            faces += written
    return ended(rng, "\n".join(lines + faces) + "\n"), every(found)


def ply(rng: random.Random) -> tuple[bytes, Surface]:
    found = pieces(rng)
    order = rng.choice(("ascii", "binary_little_endian", "binary_big_endian"))
    sign = ">" if order == "binary_big_endian" else "<"
    vertices = np.concatenate([piece.vertices for piece in found])
    offsets = np.cumsum([0, *(len(piece.vertices) for piece in found)])
    faces = [
        [int(offset) + i for i in face] for offset, piece in zip(offsets, found, strict=False) for face in piece.faces
    ]
    kind, code = rng.choice((("float", "f"), ("double", "d"), ("float32", "f")))
    length, size = rng.choice((("uchar", "B"), ("int", "i"), ("uint8", "B"), ("ushort", "H")))
    index, of = rng.choice((("int", "i"), ("uint", "I"), ("ushort", "H"), ("int32", "i")))
    extra, quality = rng.random() < 0.3, rng.random() < 0.3
    header = ["ply", f"format {order} 1.0", rng.choice(("comment made by x", "obj_info nothing"))]
    header += [f"element vertex {len(vertices)}", *(f"property {kind} {axis}" for axis in "xyz")]
    header += ["property uchar red"] if extra else []
    header += [f"element face {len(faces)}"] + (["property float quality"] if quality else [])
    header += [f"property list {length} {index} {rng.choice(('vertex_indices', 'vertex_index'))}", "end_header"]
    if order == "ascii":
        rows = [numbers(rng, vertex) + (" 255" if extra else "") for vertex in vertices]
        rows += [("0.5 " if quality else "") + " ".join(map(str, (len(face), *face))) for face in faces]
        body = ("\n".join(rows) + "\n").encode()
    else:
        body = b"".join(struct.pack(f"{sign}3{code}", *vertex) + (b"\xff" if extra else b"") for vertex in vertices)
        for face in faces:
            body += struct.pack(f"{sign}f", 0.5) if quality else b""
            body += struct.pack(f"{sign}{size}{len(face)}{of}", len(face), *face)
    return ("\n".join(header) + "\n").encode() + body, every(found)


def pose(rng: random.Random) -> Array:
    """A turn by quarters, a step of the grid, and a factor, perhaps mirroring."""
    axes = rng.sample(range(3), 3)
    matrix = np.eye(4)
    matrix[:3, :3] = np.eye(3)[axes] * [rng.choice((-1.0, 1.0)) for _ in range(3)] * rng.choice((1.0, 0.5, 2.0))
    matrix[:3, 3] = [rng.randint(-64, 64) / 64 for _ in range(3)]
    return matrix


def collada(rng: random.Random) -> tuple[bytes, Surface]:
    found = pieces(rng)
    unit = rng.choice((1.0, 0.01, 0.001, 0.0254))
    shapes, nodes, placed = [], [], []
    comment = "<!-- a comment -->"
    for k, piece in enumerate(found):
        kind = rng.choice(("triangles", "polylist", "polygons", "trifans", "tristrips", "several"))
        source = (
            f'<source id="p{k}"><float_array id="a{k}" count="{piece.vertices.size}">{numbers(rng, piece.vertices.ravel())}'
            f'</float_array><technique_common><accessor source="#a{k}" count="{len(piece.vertices)}" stride="3"><param name="X" '
            'type="float"/><param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>'
        )
        vertices = f'<vertices id="v{k}"><input semantic="POSITION" source="#p{k}"/></vertices>'
        two = rng.random() < 0.3
        inputs = f'<input semantic="VERTEX" source="#v{k}" offset="{int(two)}"/>'
        inputs += f'<input semantic="TEXCOORD" source="#p{k}" offset="0"/>' if two else ""

        def indices(face: Sequence[int], two: bool = two) -> str:
            return " ".join(f"0 {i}" if two else str(i) for i in face)

        first, second = piece.faces[:2], piece.faces[2:]
        groups = ((kind, piece.faces),) if kind != "several" else (("triangles", first), ("polylist", second))
        body = ""
        for tag, faces in groups:
            fans = [face[:1] + face[i : i + 2] for face in faces for i in range(1, len(face) - 1)]
            body += rng.choice(("", comment, "\n  "))
            if tag == "triangles":
                row = " ".join(map(indices, fans))
                body += f'<triangles count="{len(fans)}">{inputs}<p>{row}</p></triangles>'
            elif tag == "polylist":
                sizes, row = " ".join(str(len(face)) for face in faces), " ".join(map(indices, faces))
                body += f'<polylist count="{len(faces)}">{inputs}<vcount>{sizes}</vcount><p>{row}</p></polylist>'
            else:
                parts = fans if tag == "tristrips" else faces
                rows = "".join(f"<p>{indices(part)}</p>" for part in parts)
                body += f'<{tag} count="{len(parts)}">{inputs}{rows}</{tag}>'
        extra = rng.choice(("", "<extra><technique profile='x'/></extra>", comment))
        shapes.append(
            f'<geometry id="g{k}">{extra}<mesh>{source}{comment if two else ""}{vertices}{body}</mesh></geometry>'
        )
        for _ in range(rng.choice((1, 1, 2))):
            outer, inner = pose(rng), pose(rng)
            texts = [" ".join(map(repr, one.ravel().tolist())) for one in (outer, inner)]
            nodes.append(
                f"<node><matrix>{texts[0]}</matrix>{rng.choice(('', comment))}<node><matrix>{texts[1]}</matrix>"
                f'<instance_geometry url="#g{k}"/></node></node>'
            )
            placed.append(piece.moved(outer @ inner))
    text = (
        f'<?xml version="1.0" encoding="utf-8"?>\n<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">'
        f'<asset><unit name="u" meter="{unit}"/><up_axis>Z_UP</up_axis></asset>{comment}<library_geometries>'
        f'{"".join(shapes)}</library_geometries><library_visual_scenes><visual_scene id="s">{"".join(nodes)}</visual_scene>'
        '</library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>'
    )
    scaled = [Piece(piece.vertices * unit, piece.faces) for piece in placed]
    return ended(rng, text), every(scaled)


def glb(rng: random.Random) -> tuple[bytes, Surface]:
    found = [piece.cut for piece in pieces(rng)]
    binary, views, accessors, meshes, placed = b"", [], [], [], []
    nodes: list[dict[str, object]] = []
    primitives: list[dict[str, object]]

    def put(data: bytes, kind: int, count: int, shape: str, **more: object) -> int:
        nonlocal binary
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(data)})
        binary += data + b"\0" * (-len(data) % 4)
        accessors.append({"bufferView": len(views) - 1, "componentType": kind, "count": count, "type": shape, **more})
        return len(accessors) - 1

    for k, piece in enumerate(found):
        faces = np.array(piece.faces)
        mode = rng.choice(("indexed", "plain", "fan", "strip"))
        low, high = piece.vertices.min(0).tolist(), piece.vertices.max(0).tolist()
        primitives = []
        if mode == "plain":
            corners = piece.vertices[faces].reshape(-1, 3).astype("<f4")
            primitives.append(
                {"attributes": {"POSITION": put(corners.tobytes(), 5126, len(corners), "VEC3", min=low, max=high)}}
            )
        else:
            points = put(piece.vertices.astype("<f4").tobytes(), 5126, len(piece.vertices), "VEC3", min=low, max=high)
            kind, dtype = rng.choice(((5121, "u1"), (5123, "<u2"), (5125, "<u4")))
            parts = [faces.ravel()] if mode == "indexed" else list(faces)
            for part in parts:
                at = put(part.astype(dtype).tobytes(), kind, len(part), "SCALAR")
                number_of = {"indexed": 4, "strip": 5, "fan": 6}[mode]
                primitives.append({"attributes": {"POSITION": points}, "indices": at, "mode": number_of})
        meshes.append({"primitives": primitives})
        for _ in range(rng.choice((1, 1, 2))):
            outer, inner = pose(rng), pose(rng)
            child = len(nodes)
            nodes.append({"mesh": k, "matrix": inner.T.ravel().tolist()})
            nodes.append({"children": [child], "matrix": outer.T.ravel().tolist()})
            placed.append(piece.moved(outer @ inner))
    roots = [k for k in range(len(nodes)) if "children" in nodes[k]]
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": roots}],
        "nodes": nodes,
        "meshes": meshes,
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(binary)}],
    }
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    content = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    upright = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    return struct.pack("<4sII", b"glTF", 2, 12 + len(content)) + content, every([one.moved(upright) for one in placed])


WRITERS: dict[str, tuple[str, Callable[[random.Random], tuple[bytes, Surface]]]] = {
    "STL text": (".stl", stl_text),
    "STL binary": (".stl", stl_binary),
    "OBJ": (".obj", obj),
    "PLY": (".ply", ply),
    "COLLADA": (".dae", collada),
    "GLB": (".glb", glb),
}
"""By the name of a format: its suffix, and what writes a random file of it."""
