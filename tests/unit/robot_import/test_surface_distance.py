"""Distances to a link's surface are those to its triangles, however few and large these are."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from zarm_robot_import.kernels.surface_distance import least_distances
from zarm_robot_import.surface_distance import SurfaceDistance, sticks_out

BOX = np.array(trimesh.creation.box((1.4, 0.9, 0.6)).triangles)


def test_distances_to_a_large_box_are_tight_lower_bounds() -> None:
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (500, 3))
    beyond = np.abs(points) - (0.7, 0.45, 0.3)
    expected = np.where(
        (beyond < 0.0).all(axis=1), -beyond.max(axis=1), np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
    )
    excess = SurfaceDistance(BOX).of(points) - expected
    assert excess.min() > -1e-12
    assert excess.max() < 1e-4


def test_a_triangle_without_area_is_a_line_or_a_point() -> None:
    line, point = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.5, 0.0, 0.0)], [(0.0, 0.0, 2.0)] * 3
    points = np.array([(0.5, 0.3, 0.4), (2.0, 0.0, 0.0), (0.0, 0.0, 1.9)])
    found = least_distances(points, np.array([line, point]), np.array([[0, 1]] * 3))
    assert found.tolist() == pytest.approx([0.5, 1.0, 0.1])


def test_a_large_mesh_does_not_stick_out_of_its_own_hull() -> None:
    ball = trimesh.creation.icosphere(3, 1.0)
    ball.apply_scale((1.0, 0.6, 0.4))
    dented = ball.copy()
    dented.vertices[::7] *= 0.8
    hull = np.array(dented.convex_hull.triangles)
    assert sticks_out(np.array(dented.triangles), hull, 0.001) == 0.0
    assert sticks_out(np.array(dented.triangles) + (0.02, 0.0, 0.0), hull, 0.001) == pytest.approx(0.02, abs=0.002)
