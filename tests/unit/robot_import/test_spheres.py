"""The sphere cover: it contains the exact geometry, keeps its budget, and takes little space that it need not."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from zarm_contract.collision import CollisionCapsule, CollisionCuboid, CollisionCylinder, CollisionPrimitive
from zarm_robot_import.primitives import packed_shapes_of, triangles_of
from zarm_robot_import.spheres import ball_rows, fit_covers, protrusion

TUBE = CollisionCylinder(kind="cylinder", a=(0.0, 0.0, 0.0), b=(0.0, 0.0, 0.6), radius=0.06)
PLATE = CollisionCuboid(kind="cuboid", center=(0.1, 0.0, 0.0), size=(0.3, 0.2, 0.02), orientation=(0.0, 0.0, 0.0, 1.0))
ELBOW = CollisionCapsule(kind="capsule", a=(0.0, 0.0, 0.6), b=(0.0, 0.2, 0.7), radius=0.05)


def points_in(shape: CollisionPrimitive, count: int) -> np.ndarray:
    """Random points of a shape, by its definition."""
    rng = np.random.default_rng(0)
    if isinstance(shape, CollisionCuboid):
        return np.array(shape.center) + rng.uniform(-0.5, 0.5, (count, 3)) * shape.size
    assert isinstance(shape, (CollisionCylinder, CollisionCapsule))
    a, b = np.array(shape.a), np.array(shape.b)
    along = (b - a) / np.linalg.norm(b - a)
    if isinstance(shape, CollisionCapsule):
        ball = rng.normal(size=(count, 3))
        ball *= shape.radius * rng.uniform(size=(count, 1)) ** 0.1 / np.linalg.norm(ball, axis=1, keepdims=True)
        return a + rng.uniform(size=(count, 1)) * (b - a) + ball
    across = np.cross(along, rng.normal(size=(count, 3)))
    across *= shape.radius * rng.uniform(size=(count, 1)) ** 0.1 / np.linalg.norm(across, axis=1, keepdims=True)
    return a + rng.choice([0.0, 0.3, 0.7, 1.0], (count, 1)) * (b - a) + across


def within(points: np.ndarray, balls: np.ndarray) -> np.ndarray:
    """Which points are in some ball."""
    return (np.linalg.norm(points[:, None] - balls[:, :3], axis=2) <= balls[:, 3]).any(axis=1)


def test_a_sphere_s_excess_is_what_is_outside_all_shapes() -> None:
    cubes: list[CollisionPrimitive] = [
        CollisionCuboid(kind="cuboid", center=(x, y, z), size=(0.05, 0.05, 0.05), orientation=(0.0, 0.0, 0.0, 1.0))
        for x, y, z in itertools.product((-0.025, 0.025), repeat=3)
    ]
    around = np.array((0.0, 0.0, 0.0, 0.05 * np.sqrt(3)))
    assert protrusion(around, packed_shapes_of(cubes)) == pytest.approx(around[3] - 0.05, abs=0.002)


@pytest.mark.lengthy
def test_a_cover_contains_every_shape_within_its_budget() -> None:
    links = {"arm": [TUBE, ELBOW], "plate": [PLATE]}
    covers = fit_covers({link: packed_shapes_of(shapes) for link, shapes in links.items()}, {"arm": 1, "plate": 1}, 20)
    assert sum(map(len, covers.values())) <= 20
    for link, shapes in links.items():
        for shape in shapes:
            assert within(points_in(shape, 20_000), covers[link]).all()


@pytest.mark.lengthy
def test_a_tube_costs_a_third_more_volume_in_twelve_spheres() -> None:
    """The least that balls in a row can do is a fifth more: what their waists need, and half a ball at each end."""
    (balls,) = fit_covers({"tube": packed_shapes_of([TUBE])}, {"tube": 1}, 12).values()
    space = np.random.default_rng(1).uniform((-0.2, -0.2, -0.2), (0.2, 0.2, 0.8), (100_000, 3))
    volume = 0.4 * 0.4 * 1.0 * within(space, balls).mean()
    assert volume < 1.35 * np.pi * 0.06**2 * 0.6


@pytest.mark.lengthy
def test_links_that_move_more_get_more_spheres() -> None:
    same = packed_shapes_of([TUBE])
    covers = fit_covers({"base": same, "arm": same, "hand": same}, {"base": 0, "arm": 1, "hand": 6}, 24)
    assert len(covers["base"]) < len(covers["arm"]) < len(covers["hand"])


@pytest.mark.lengthy
def test_small_and_large_links_get_equally_many_spheres() -> None:
    small = CollisionCylinder(kind="cylinder", a=(0.0, 0.0, 0.0), b=(0.0, 0.0, 0.15), radius=0.015)
    covers = fit_covers(
        {"large": packed_shapes_of([TUBE]), "small": packed_shapes_of([small])}, {"large": 1, "small": 1}, 20
    )
    assert len(covers["small"]) >= 6


@pytest.mark.lengthy
def test_every_ball_is_large_enough_to_be_drawn_and_measured() -> None:
    """More balls than a small link has use for: some would shrink to a point."""
    tiny = CollisionCuboid(
        kind="cuboid", center=(0.0, 0.0, 0.0), size=(0.012, 0.008, 0.004), orientation=(0.0, 0.0, 0.0, 1.0)
    )
    (balls,) = fit_covers({"tiny": packed_shapes_of([tiny])}, {"tiny": 1}, 40).values()
    assert balls[:, 3].min() >= 0.002
    assert all(len(triangles_of(row)) for row in ball_rows(balls))
