"""Random files of every format: what zarm reads is what was written, and what Assimp reads too, where it reads it all."""

from __future__ import annotations

import random
from pathlib import Path

import assimp_py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from support.examples import examples
from support.mesh_writing import WRITERS, Surface
from zarm_geometry import mesh_files

pytestmark = pytest.mark.lengthy

FLAGS = assimp_py.Process_Triangulate | assimp_py.Process_PreTransformVertices
UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Assimp turns y up in these formats."""
TURNED = (".glb", ".dae")


def assimp(file: Path) -> Surface | None:
    """What Assimp reads, in the frame and the unit in which zarm does; None for what it cannot read: STL in capitals, and OBJ
    whose lines continue.
    """
    try:
        scene = assimp_py.import_file(str(file), FLAGS)
    except RuntimeError:
        return None
    found = [
        np.array(mesh.vertices, np.float64).reshape(-1, 3)[np.array(mesh.indices).reshape(-1, 3)]
        for mesh in scene.meshes
    ]
    triangles = np.concatenate(found)
    return Surface.of(triangles @ UPRIGHT.T if file.suffix in TURNED else triangles)


@pytest.mark.parametrize("name", WRITERS)
def test_what_is_read_is_what_was_written_and_what_assimp_reads(
    name: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    suffix, write = WRITERS[name]
    file = tmp_path_factory.mktemp("meshes") / f"mesh{suffix}"
    compared: list[bool] = []

    @examples(20)
    @given(seed=st.integers(0, 2**32))
    def check(seed: int) -> None:
        content, written = write(random.Random(seed))
        read = mesh_files.read(file.name, content)
        written.assert_same(Surface.of(read.triangles), 1e-6)
        assert read.notes == ()
        file.write_bytes(content)
        other = assimp(file)
        # Assimp drops small polygons of COLLADA, and does not turn what is mirrored.
        compared.append(other is not None and other.count == written.count)
        if compared[-1]:
            assert other is not None
            size = np.abs(written.bounds).max()
            np.testing.assert_allclose(other.bounds, written.bounds, atol=1e-5 * size)
            assert other.area[3] == pytest.approx(written.area[3], rel=1e-5)
            if suffix not in TURNED:
                written.assert_same(other, 1e-5)

    check()
    assert np.mean(compared) > 0.6
