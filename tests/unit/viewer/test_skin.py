"""The arms that come with zarm have smooth bodies, which lie close to their exact geometry."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from zarm_contract.collision import CollisionPrimitive
from zarm_contract.robot import ROBOTS, load_robot
from zarm_viewer.drawing import link_mesh
from zarm_viewer.skin import DEVIATION, skin

SAMPLES = 5_000
ROUNDED = 0.003
"""By how much (m) rounded edges are inside of sharp ones."""
LINKS = [
    pytest.param(primitives, id=f"{file.stem}-{link}")
    for file in sorted(ROBOTS.glob("*.yaml"))
    for link, primitives in load_robot(str(file)).descriptor.collision.items()
    if skin(primitives) is not None
]


def sampled(mesh: trimesh.Trimesh) -> np.ndarray:
    points, _ = trimesh.sample.sample_surface(mesh, SAMPLES, seed=0)
    return np.asarray(points)


def inside(primitive: CollisionPrimitive, points: np.ndarray) -> np.ndarray:
    """Which points lie more than a hundredth of a mm inside a primitive, whose mesh is convex."""
    mesh = link_mesh((primitive,))
    depth = np.einsum("ij,ij->i", mesh.face_normals, mesh.triangles[:, 0])
    return np.all(points @ mesh.face_normals.T < depth - 1e-5, axis=1)


def windings(mesh: trimesh.Trimesh, points: np.ndarray) -> np.ndarray:
    """How often a mesh winds around points: 1 inside, 0 outside (Van Oosterom and Strackee, "The solid angle of a plane triangle", 1983)."""
    found = []
    for point in points:
        a, b, c = np.moveaxis(mesh.triangles - point, 1, 0)
        x, y, z = (np.linalg.norm(one, axis=1) for one in (a, b, c))
        volume = np.einsum("ij,ij->i", a, np.cross(b, c))
        over = x * y * z + (a * b).sum(1) * z + (b * c).sum(1) * x + (c * a).sum(1) * y
        found.append(2.0 * np.arctan2(volume, over).sum() / (4.0 * np.pi))
    return np.array(found)


@pytest.mark.parametrize("primitives", LINKS)
def test_the_skin_covers_the_surface_within_10_mm(
    primitives: tuple[CollisionPrimitive, ...],
) -> None:
    body = skin(primitives)
    assert body is not None
    each = [sampled(link_mesh((one,))) for one in primitives]
    hidden = [
        np.any([inside(other, points) for other in primitives if other is not one], axis=0)
        for one, points in zip(primitives, each, strict=True)
    ]
    exact = np.concatenate([points[~under] for points, under in zip(each, hidden, strict=True)])
    smooth = sampled(body)
    spacing = (
        2.0 * float(np.sqrt(body.area / SAMPLES)) + 1e-3
    )  # of the samples, and by how much facets are inside of what is round
    assert cKDTree(exact).query(smooth)[0].max() <= DEVIATION + spacing
    some = exact[:: max(1, len(exact) // 100)]
    outside = some[windings(body, some) < 0.5]
    away = cKDTree(smooth).query(outside)[0].max(initial=0.0)
    assert away <= ROUNDED + spacing, "nothing of the robot stands out of its picture but rounded edges"


def test_skin_faces_outwards_and_every_robot_of_ours_has_one() -> None:
    for file in ROBOTS.glob("*.yaml"):
        bodies = [skin(primitives) for primitives in load_robot(str(file)).descriptor.collision.values()]
        shown = [body for body in bodies if body is not None]
        assert len(shown) >= len(bodies) / 2
        assert all(body.volume > 0.0 for body in shown)
        assert all(len(body.faces) < 15_000 for body in shown), "a browser draws several arms"
