"""Nothing of a mesh file is left out in silence: each kind of part is read, noted, or refused with its place."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest

from support.paths import ROOT
from zarm_geometry import mesh_files

CASES = ROOT.parent / "shared" / "cases" / "reading"

CUBE = [(x, y, z) for x in (0.0, 0.1) for y in (0.0, 0.1) for z in (0.0, 0.1)]
QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]


def obj(*blocks: tuple[float, bool]) -> str:
    """Cubes at these distances along x, each a block of `v` and `f`, by negative indices or by positive ones."""
    lines, count = [], 0
    for away, negative in blocks:
        lines += [f"v {x + away} {y} {z}" for x, y, z in CUBE]
        count += 8
        first = -8 if negative else count - 7
        lines += ["f " + " ".join(str(first + corner) for corner in face) for face in QUADS]
    return "\n".join(lines) + "\n"


def triangles(count: int) -> bytes:
    return struct.pack("<12fH", 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0) * count


def binary_stl(held: int, count: int, header: bytes = b"made by x", rest: bytes = b"") -> bytes:
    return header.ljust(80) + struct.pack("<I", held) + triangles(count) + rest


def dae(mesh: str, nodes: str = '<node><instance_geometry url="#g"/></node>', asset: str = "") -> str:
    return (
        '<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">'
        f'<asset>{asset}</asset><library_geometries><geometry id="g"><mesh><source id="p">'
        '<float_array id="a" count="12">0 0 0 1 0 0 1 1 0 0 1 0</float_array><technique_common><accessor source="#a" count="4" '
        'stride="3"><param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/></accessor>'
        '</technique_common></source><vertices id="v"><input semantic="POSITION" source="#p"/></vertices>'
        f'{mesh}</mesh></geometry></library_geometries><library_visual_scenes><visual_scene id="s">{nodes}</visual_scene>'
        '</library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>'
    )


INPUT = '<input semantic="VERTEX" source="#v" offset="0"/>'
TRIANGLE = f'<triangles count="1">{INPUT}<p>0 1 2</p></triangles>'


def read(name: str, content: bytes | str) -> mesh_files.MeshFile:
    return mesh_files.read(name, content.encode() if isinstance(content, str) else content)


def test_negative_obj_indices_equal_positive_ones() -> None:
    both = [read("cubes.obj", obj((-0.2, negative), (0.2, negative))).triangles for negative in (True, False)]
    assert len(both[0]) == 24
    np.testing.assert_array_equal(both[0], both[1])


@pytest.mark.skipif(not CASES.exists(), reason="the shared cases are not here")
@pytest.mark.parametrize(("one", "other"), [("neg2.obj", "pos_blocks.obj"), ("com2.dae", "plain2.dae")])
def test_two_ways_to_write_the_same_are_read_alike(one: str, other: str) -> None:
    found = [mesh_files.read(name, (CASES / name).read_bytes()).triangles for name in (one, other)]
    assert len(found[0]) == 24
    np.testing.assert_allclose(found[0], found[1])


@pytest.mark.parametrize(
    ("name", "content", "count", "note"),
    [
        ("a.stl", binary_stl(2, 2, b"solid that is binary"), 2, None),
        ("a.stl", binary_stl(2, 2, rest=b"\0" * 7), 2, "7 bytes after its last triangle"),
        ("a.obj", obj((0, False)) + "l 1 2 3\np 1\n", 12, "1 line"),
        ("a.obj", obj((0, False)).replace("f 1", "f \\\n 1"), 12, None),
        ("a.obj", "\ufeff# Grüße\n" + obj((0, False)), 12, None),
        ("a.obj", "v 0 0 0\nv 2 0 0\nv 2 2 0\nv 1 0.5 0\nv 0 2 0\nf 1 2 3 4 5\n", 3, None),
        ("a.dae", dae(f"<!-- a comment -->{TRIANGLE}<!-- another -->{TRIANGLE}"), 2, None),
        ("a.dae", dae(f'{TRIANGLE}<lines count="1">{INPUT}<p>0 1</p></lines>'), 1, "1 line"),
        ("a.dae", dae(TRIANGLE, asset="<up_axis>Y_UP</up_axis>"), 1, "Y_UP"),
        ("a.dae", dae(f'<tristrips count="1">{INPUT}<p>0 1 3 2</p></tristrips>'), 2, None),
        ("a.dae", dae(f'<trifans count="1">{INPUT}<p>0 1 2 3</p></trifans>'), 2, None),
        ("a.dae", dae(f'<polygons count="1">{INPUT}<p>0 1 2 3</p></polygons>'), 2, None),
        ("a.dae", dae(TRIANGLE, '<node><instance_geometry url="#g"/></node>' * 3), 3, None),
        ("a.dae", dae(f"{TRIANGLE}<mystery/>"), 1, "<mystery> in <mesh> is not known"),
    ],
)  # fmt: skip
def test_what_is_there_is_read_and_what_is_no_surface_is_noted(
    name: str, content: bytes | str, count: int, note: str | None
) -> None:
    found = read(name, content)
    assert len(found.triangles) == count
    assert (found.notes == ()) if note is None else (note in found.notes[0])


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("a.stl", binary_stl(3, 2), "announces 3 triangles, and its 184 bytes have room for 2"),
        ("a.stl", binary_stl(1, 3), "announces 1 triangle, and its 234 bytes have room for 3"),
        ("a.stl", "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nendloop\nendfacet\nendsolid a\n", "line 2"),
        ("a.stl", "solid a\n" + "facet normal 0 0 1 outer loop vertex 0 0 0 vertex 1 0 0 vertex 0 1 0 endloop endfacet\n", "endsolid"),
        ("a.obj", "v 0 0 0\nsurf 0 1 0 1\n", "line 2: 'surf' is a free-form surface"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", "line 4: a face names the vertex 4, and there are 3"),
        ("a.obj", "v 0 0 0\nface 1 2 3\n", "line 2: 'face' is no word of an OBJ file"),
        ("a.obj", "call other.obj\n", "line 1: 'call' takes in another file"),
        ("a.dae", dae(f'<triangles count="2">{INPUT}<p>0 1 2</p></triangles>'), "announces 2 triangles and has 3 corners"),
        ("a.dae", dae(f'<triangles count="1">{INPUT}<p>0 1 9</p></triangles>'), "names the vertex 9, and there are 4"),
        ("a.dae", dae(TRIANGLE, '<node><instance_geometry url="other.dae#g"/></node>'), "names another file"),
        ("a.dae", dae(TRIANGLE, '<node><instance_geometry url="#h"/></node>'), "nothing with the id 'h'"),
        ("a.ply", "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 2\n"
         "property list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", "2 faces"),
        ("a.gltf", json.dumps({"asset": {"version": "2.0"}, "extensionsRequired": ["KHR_draco_mesh_compression"]}), "KHR_draco"),
        ("a.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", "no known format"),
    ],
)  # fmt: skip
def test_incomplete_files_are_refused_with_the_place(name: str, content: bytes | str, says: str) -> None:
    with pytest.raises(mesh_files.Unreadable) as refused:
        read(name, content)
    assert says in str(refused.value)


def test_a_file_of_the_scene_causes_no_other_to_be_read(tmp_path: Path) -> None:
    buffer = {"uri": "beside.bin", "byteLength": 36}
    (tmp_path / "beside.bin").write_bytes(np.eye(3, dtype="<f4").tobytes())
    document = {
        "asset": {"version": "2.0"},
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [buffer],
    }
    content = json.dumps(document).encode()
    with pytest.raises(mesh_files.Unreadable, match=r"names the file beside\.bin"):
        mesh_files.read("a.gltf", content)
    assert len(mesh_files.read("a.gltf", content, lambda name: (tmp_path / name).read_bytes()).triangles) == 1
    buffer["uri"] = "../beside.bin"
    with pytest.raises(mesh_files.Unreadable, match="which is not read from there"):
        mesh_files.read("a.gltf", json.dumps(document).encode(), lambda name: (tmp_path / name).read_bytes())
