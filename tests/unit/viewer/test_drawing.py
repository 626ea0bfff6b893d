"""Shapes in the picture have the size that files and objects say."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

from zarm_contract.messages import Mesh, SceneObject, Sphere
from zarm_viewer.drawing import file_mesh
from zarm_viewer.objects_panel import _resized, _size


def test_a_collada_mesh_is_drawn_in_metres_whatever_its_unit(tmp_path: Path) -> None:
    file = tmp_path / "box.dae"
    written = trimesh.creation.box((10.0, 20.0, 30.0)).export(file_type="dae").decode()
    file.write_text(re.sub(r"<asset>", '<asset><unit name="centimeter" meter="0.01"/>', written))
    assert np.allclose(file_mesh(file, (1.0, 1.0, 2.0)).extents, (0.1, 0.2, 0.6))


def test_a_file_that_is_no_mesh_is_said_to_be_unreadable(tmp_path: Path) -> None:
    for name in ("broken.dae", "broken.stl"):
        (tmp_path / name).write_text("no mesh")
        with pytest.raises(ValueError, match="cannot be read"):
            file_mesh(tmp_path / name, (1.0, 1.0, 1.0))


@pytest.mark.parametrize(
    "item",
    [
        Sphere(kind="sphere", name="ball", position=(0.0, 0.0, 0.0), radius=0.1),
        Mesh(kind="mesh", name="part", position=(0.0, 0.0, 0.0), file="part.stl"),
    ],
)
def test_an_object_that_is_resized_has_that_size_and_stays_what_it_was(item: SceneObject) -> None:
    larger = _resized(item, (0.3, 0.3, 0.3))
    assert _size(larger) == (0.3, 0.3, 0.3)
    assert (larger.kind, larger.name, larger.position) == (item.kind, item.name, item.position)
