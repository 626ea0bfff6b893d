"""The exact geometry of a link: few primitives that contain its surface and hardly more."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from zarm_geometry.packed_shapes import distances
from zarm_robot_import import decomposition
from zarm_robot_import.body import Body
from zarm_robot_import.cutting import cut
from zarm_robot_import.decomposition import fit_primitives
from zarm_robot_import.primitives import packed_shapes_of, triangles_of
from zarm_robot_import.protrusion import MEAN, MOST, Measure

Array = np.ndarray


def turned(mesh: trimesh.Trimesh, angles: tuple[float, float, float], to: tuple[float, float, float]) -> Array:
    mesh.apply_transform(trimesh.transformations.euler_matrix(*angles))
    mesh.apply_translation(to)
    return np.array(mesh.triangles)


BOX = turned(trimesh.creation.box((0.1, 0.2, 0.3)), (0.3, 0.7, 0.2), (0.1, 0.0, 0.2))
TUBE = turned(trimesh.creation.cylinder(0.05, 0.4), (0.0, 0.5, 0.0), (0.0, 0.1, 0.0))
BALL = turned(trimesh.creation.icosphere(3, 0.07), (0.0, 0.0, 0.0), (0.0, 0.1, 0.0))
CAPSULE = turned(trimesh.creation.capsule(0.3, 0.05), (0.0, 0.5, 0.0), (0.0, 0.1, 0.0))
ELBOW = np.concatenate(
    [
        turned(trimesh.creation.cylinder(0.05, 0.3), (0.0, 0.0, 0.0), (0.0, 0.0, 0.15)),
        turned(trimesh.creation.cylinder(0.05, 0.3), (np.pi / 2, 0.0, 0.0), (0.0, -0.1, 0.3)),
    ]
)
SHAPES = {"box": BOX, "tube": TUBE, "ball": BALL, "capsule": CAPSULE, "elbow": ELBOW}


@pytest.mark.lengthy
@pytest.mark.parametrize("name", SHAPES)
def test_primitives_contain_every_corner_tightly(name: str) -> None:
    triangles = SHAPES[name]
    body = Body.of(triangles)
    rows = packed_shapes_of(fit_primitives(body))
    corners = triangles.reshape(-1, 3)
    rng = np.random.default_rng(1)
    inner = np.einsum("kn,nki->ni", rng.dirichlet((1, 1, 1), len(triangles)).T, triangles)
    assert distances(np.concatenate([corners, inner]), rows).min(axis=1).max() <= 0.0
    out = Measure(body).all(rows)
    assert out.most < MOST + 0.001
    assert out.mean < MEAN


@pytest.mark.lengthy
def test_the_second_kind_of_geometry_is_contained_with_tolerance(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(decomposition, "_ENOUGH", 0.0)
    outer, off = np.array(trimesh.creation.box((0.1, 0.2, 0.3)).triangles), 0.002
    larger = outer + np.sign(outer) * off / 2
    rows = packed_shapes_of(fit_primitives(Body.of(outer, larger, off=off)))
    corners = np.concatenate([outer, larger]).reshape(-1, 3)
    assert distances(corners, rows).min(axis=1).max() <= 1e-6 - off


@pytest.mark.lengthy
def test_a_link_as_small_as_a_finger_is_contained_more_tightly() -> None:
    size = 0.06
    body = Body.of(ELBOW * size / np.ptp(ELBOW, axis=(0, 1)).max())
    out = Measure(body).all(packed_shapes_of(fit_primitives(body)))
    assert out.most < MOST / 2
    assert out.mean < MEAN / 2


@pytest.mark.lengthy
@pytest.mark.parametrize(
    ("name", "kind"), [("box", "cuboid"), ("tube", "cylinder"), ("ball", "sphere"), ("capsule", "capsule")]
)
def test_a_link_that_is_a_primitive_is_taken_for_that(name: str, kind: str) -> None:
    assert [primitive.kind for primitive in fit_primitives(Body.of(SHAPES[name]))] == [kind]


def test_cut_triangles_stay_on_their_side_and_keep_their_area() -> None:
    normal = np.array((0.6, 0.0, 0.8))
    below, above, across = cut(ELBOW, normal, 0.11)
    assert (below @ normal).max() <= 0.11 + 1e-12
    assert (above @ normal).min() >= 0.11 - 1e-12
    np.testing.assert_allclose(across @ normal, 0.11, atol=1e-12)
    assert area(below) + area(above) == pytest.approx(area(ELBOW))


@pytest.mark.parametrize(("half", "radius"), [(0.1, 0.03), (1e-4, 0.05), (0.0, 0.04)])
def test_a_capsule_s_surface_is_its_radius_from_its_axis(half: float, radius: float) -> None:
    row = np.zeros(17)
    row[[0, 5, 10]], row[14], row[16] = 1.0, half, radius
    points = triangles_of(row).reshape(-1, 3)
    axis = np.zeros_like(points)
    axis[:, 2] = np.clip(points[:, 2], -half, half)
    np.testing.assert_allclose(np.linalg.norm(points - axis, axis=1), radius, rtol=1e-9)
    assert np.ptp(points[:, 2]) == pytest.approx(2 * (half + radius))


def area(triangles: Array) -> float:
    a, b, c = triangles.transpose(1, 0, 2)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)
