"""What rows of shapes promise: everybody who measures a triangle, kernels, numpy and FCL, finds the same distance."""

from __future__ import annotations

import numba
import numpy as np
import pytest
import trimesh

from support.planner.sphere_model import distance as gap_to
from support.planner.sphere_model import random_objects
from zarm_contract.collision import CollisionCuboid, CollisionCylinder
from zarm_geometry import packed_shapes
from zarm_geometry.kernels.collision import squared_distance
from zarm_geometry.kernels.convex import core_gap
from zarm_geometry.kernels.simd import LANES, load, pointer, store
from zarm_geometry.shapes import distance, link_shape, obstacle_shape
from zarm_geometry.world import World
from zarm_trajectory.arrays import Array, Single


@numba.njit
def squared_distances(shapes: Single, x: Single, y: Single, z: Single, found: Single) -> None:
    """Of the first shape to many points."""
    for i in range(0, x.shape[0], LANES):
        at = load(pointer(x), i), load(pointer(y), i), load(pointer(z), i)
        store(pointer(found), i, squared_distance(pointer(shapes), 0, at[0], at[1], at[2]))


@numba.njit
def bounds(center: Array, turn: Array, one: Array, other: Array) -> tuple[float, float]:
    """Of the distance of a core, placed in the frame of another, to that."""
    lower, upper, _, _ = core_gap(
        (center[0], center[1], center[2]),
        (turn[0, 0], turn[0, 1], turn[0, 2], turn[1, 0], turn[1, 1], turn[1, 2], turn[2, 0], turn[2, 1], turn[2, 2]),
        (one[0], one[1], one[2], one[3]),
        (other[0], other[1], other[2], other[3]),
        np.inf,
    )
    return lower, upper


def kernel_distances(row: Array, points: Array) -> Array:
    x, y, z = np.ascontiguousarray(points.T, np.float32)
    found = np.empty_like(x)
    squared_distances(row.astype(np.float32)[None], x, y, z, found)
    return np.sqrt(found.astype(np.float64))


@pytest.mark.lengthy
def test_the_distance_to_a_triangle_is_that_of_trimesh() -> None:
    rng = np.random.default_rng(0)
    for number in range(60):
        corners = rng.normal(size=(1, 3, 3))
        if number % 3 == 0:  # a needle
            corners[0, 2] = corners[0, 0] + 0.7 * (corners[0, 1] - corners[0, 0]) + 1e-4 * rng.normal(size=3)
        points = rng.normal(size=(LANES * 20, 3))
        points[: LANES * 5] = rng.dirichlet((1, 1, 1), LANES * 5) @ corners[0]
        triangle = packed_shapes.triangles(corners)
        assert len(triangle) == 1
        nearest = trimesh.triangles.closest_point(np.repeat(corners, len(points), axis=0), points)
        expected = np.linalg.norm(nearest - points, axis=1)
        np.testing.assert_allclose(kernel_distances(triangle[0], points), expected, rtol=1e-4, atol=2e-6)
        np.testing.assert_allclose(packed_shapes.distances(points, triangle)[:, 0], expected, atol=1e-6)


def test_distances_to_shapes_are_signed() -> None:
    rng = np.random.default_rng(7)
    objects = random_objects(40, 0.4, rng)
    points = rng.uniform(-1.2, 1.2, (30, 3))
    world = World(objects, 0.0)
    found = packed_shapes.distances(points, world.rows)
    expected = np.column_stack([gap_to(objects[owner], points) for owner in world.owner])
    np.testing.assert_allclose(found.clip(0.0), expected, atol=1e-9)
    assert np.any(found < 0.0)


def test_a_packed_triangle_gives_back_its_corners() -> None:
    corners = np.random.default_rng(1).normal(size=(50, 3, 3))
    pose = trimesh.transformations.compose_matrix(angles=(0.3, 1.0, -2.0), translate=(1.0, -2.0, 0.5))
    moved = packed_shapes.placed(packed_shapes.triangles(corners), pose)
    expected = trimesh.transform_points(corners.reshape(-1, 3), pose).reshape(-1, 3, 3)
    for found, wanted in zip(packed_shapes.corners(moved), expected, strict=True):
        apart = np.linalg.norm(found[:, None] - wanted, axis=2)
        assert apart.min(axis=1).max() < 1e-12
        assert apart.min(axis=0).max() < 1e-12
    lower, upper = packed_shapes.bounds(moved)
    np.testing.assert_allclose(lower, expected.min(axis=1), atol=1e-12)
    np.testing.assert_allclose(upper, expected.max(axis=1), atol=1e-12)


def test_triangles_that_are_only_lines_are_left_out() -> None:
    corners = np.random.default_rng(2).normal(size=(4, 3, 3))
    corners[1, 2] = corners[1, 1]
    corners[2, 2] = 0.3 * corners[2, 0] + 0.7 * corners[2, 1]
    corners[3] = corners[3, 0]
    assert len(packed_shapes.triangles(corners)) == 1


@pytest.mark.lengthy
def test_triangle_distance_bounds_enclose_fcl_s() -> None:
    rng = np.random.default_rng(6)
    box = CollisionCuboid(kind="cuboid", center=(0.0, 0.0, 0.0), size=(0.2, 0.3, 0.4))
    can = CollisionCylinder(kind="cylinder", a=(0.0, 0.0, -0.2), b=(0.0, 0.0, 0.2), radius=0.1)
    apart = overlapping = 0
    for number in range(400):
        part = link_shape("link", can if number % 2 else box)
        size, far = rng.choice([0.02, 0.3, 1.0]), rng.choice([0.05, 0.5])
        row = packed_shapes.triangles(far * rng.normal(size=(1, 1, 3)) + size * rng.normal(size=(1, 3, 3)))[0]
        triangle = obstacle_shape("triangle", row)
        between = np.linalg.inv(triangle.pose) @ part.pose
        lower, upper = bounds(between[:3, 3], between[:3, :3], np.array((*part.core, part.disc)), row[12:16])
        measured = distance(part, part.pose, triangle, triangle.pose)
        if measured > 0.0:
            apart += 1
            assert lower - 1e-9 <= measured <= upper + 5e-4
            assert upper >= lower - 1e-12
        else:
            overlapping += 1
            assert lower <= 0.0
            assert upper < 1e-6
    assert min(apart, overlapping) > 50


def test_depth_in_a_plate_is_the_shortest_way_out() -> None:
    part = link_shape("link", CollisionCuboid(kind="cuboid", center=(0.0, 0.0, 0.0), size=(0.2, 0.3, 0.4)))
    for x in (0.09, 0.03, 0.0):
        corners = np.array([[(x, -0.1, -0.1), (x, 0.2, 0.0), (x, 0.0, 0.2)]])
        for turned in (corners, corners[:, ::-1]):
            triangle = obstacle_shape("plate", packed_shapes.triangles(turned)[0])
            assert distance(part, part.pose, triangle, triangle.pose) == pytest.approx(x - 0.1, abs=1e-5)
