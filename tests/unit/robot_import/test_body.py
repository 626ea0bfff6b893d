"""What is inside a link is told from all kinds of its geometry, however each of them is wound."""

from __future__ import annotations

import numpy as np
import trimesh

from zarm_robot_import.body import Body

HULL = np.array(trimesh.creation.box((0.2, 0.2, 0.2)).triangles)
PART = np.array(trimesh.creation.box((0.1, 0.1, 0.1)).triangles)
POINTS = np.array([(0.0, 0.0, 0.0), (0.04, 0.04, 0.04), (0.09, 0.0, 0.0), (0.11, 0.0, 0.0)])
IN_HULL = [True, True, True, False]


def test_an_inverted_visual_mesh_keeps_its_inside() -> None:
    for visual in (PART, PART[:, ::-1]):
        for collision in (HULL, HULL[:, ::-1]):
            body = Body.of(collision, visual)
            assert body.inside(POINTS).tolist() == IN_HULL
            surely = (np.abs(body.points) < 0.099).all(axis=1)
            assert not body.out[surely].any()


def test_what_sticks_out_of_the_collision_geometry_is_inside_too() -> None:
    body = Body.of(HULL, PART[:, ::-1] + (0.12, 0.0, 0.0))
    points = np.array([(0.0, 0.0, 0.0), (0.085, 0.0, 0.0), (0.15, 0.0, 0.0), (0.18, 0.0, 0.0)])
    assert body.inside(points).tolist() == [True, True, True, False]


def test_geometry_closed_only_together_has_an_inside() -> None:
    faces = [HULL[np.isclose(np.abs(HULL[:, :, axis]), 0.1).all(axis=1)] for axis in range(3)]
    assert Body.of(*faces).inside(POINTS).tolist() == IN_HULL
