"""Shapes in the picture have the size that files and objects say."""

from __future__ import annotations

import re
from pathlib import Path
from typing import cast

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from zarm_contract.messages import Mesh, SceneObject, Sphere
from zarm_contract.robot import load_robot
from zarm_geometry.visual_meshes import file_triangles
from zarm_viewer.drawing import link_mesh, surface
from zarm_viewer.objects_panel import _resized, _size

Points = NDArray[np.float64]


def test_a_collada_mesh_is_drawn_in_metres_whatever_its_unit(tmp_path: Path) -> None:
    file = tmp_path / "box.dae"
    written = trimesh.creation.box((10.0, 20.0, 30.0)).export(file_type="dae").decode()
    file.write_text(re.sub(r"<asset>", '<asset><unit name="centimeter" meter="0.01"/>', written))
    assert np.allclose(surface(file_triangles(file, (1.0, 1.0, 2.0))).extents, (0.1, 0.2, 0.6))


def test_a_file_that_is_no_mesh_is_said_to_be_unreadable(tmp_path: Path) -> None:
    for name in ("broken.dae", "broken.stl"):
        (tmp_path / name).write_text("no mesh")
        with pytest.raises(ValueError, match="cannot be read"):
            file_triangles(tmp_path / name, (1.0, 1.0, 1.0))


@pytest.mark.parametrize(
    "item",
    [
        Sphere(kind="sphere", name="ball", position=(0.0, 0.0, 0.0), radius=0.1),
        Mesh(kind="mesh", name="part", position=(0.0, 0.0, 0.0), file="part.stl"),
    ],
)
def test_a_resized_object_keeps_everything_else(item: SceneObject) -> None:
    larger = _resized(item, (0.3, 0.3, 0.3))
    assert _size(larger) == (0.3, 0.3, 0.3)
    assert (larger.kind, larger.name, larger.position) == (item.kind, item.name, item.position)


def test_a_link_is_drawn_whole_less_what_lies_inside_it() -> None:
    """Seen from anywhere outside, a ray meets the drawn link where it first meets one of the link's primitives."""
    random, drawn, all_of_them = np.random.default_rng(1), 0, 0
    for primitives in load_robot("doosan_m1013").descriptor.collision.values():
        parts = trimesh.util.concatenate([link_mesh([each]) for each in primitives])
        link, whole = link_mesh(primitives), cast(trimesh.Trimesh, parts)
        away = random.normal(size=(12, 3))
        starts = whole.bounds.mean(axis=0) + 2.0 * away / np.linalg.norm(away, axis=1, keepdims=True)
        ways = whole.triangles_center[random.integers(len(whole.faces), size=12)] - starts
        assert np.allclose(first_met(link, starts, ways), first_met(whole, starts, ways), atol=1e-9)
        drawn, all_of_them = drawn + len(link.faces), all_of_them + len(whole.faces)
    assert drawn < 0.7 * all_of_them


def first_met(mesh: trimesh.Trimesh, starts: Points, ways: Points) -> Points:
    """How far (1 is the whole way) each ray goes until it meets a triangle, by Moeller and Trumbore (1997)."""
    corner, along, across = (
        each[:, None] for each in (mesh.triangles[:, 0], *np.diff(mesh.triangles, axis=1).swapaxes(0, 1))
    )
    across = along + across
    slanted = np.cross(ways, across)
    area = (along * slanted).sum(axis=2)
    off = starts - corner
    with np.errstate(divide="ignore", invalid="ignore"):
        u = (off * slanted).sum(axis=2) / area
        sideways = np.cross(off, along)
        v = (ways * sideways).sum(axis=2) / area
        far = (across * sideways).sum(axis=2) / area
    met = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9) & (far > 0)
    return cast(Points, np.where(met, far, np.inf).min(axis=0))
