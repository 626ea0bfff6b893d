"""Balls that stand for a shape: they cover it whole, and stand out by little."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from support.examples import examples
from support.planner.sphere_model import distance, random_object
from zarm_geometry.packed_shapes import primitives
from zarm_geometry.shapes import obstacle_shape
from zarm_geometry.sphere_cover import MOST_BALLS, STANDS_OUT, sphere_cover

KINDS = ("cuboid", "sphere", "capsule", "cylinder")


@examples(0.6)
@given(st.sampled_from(KINDS), st.floats(0.01, 0.6), st.integers(0, 2**32 - 1))
def test_a_few_balls_cover_a_shape_whole(kind: str, size: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    item = random_object(kind, "thing", rng.normal(size=3), size, rng)
    balls = sphere_cover(obstacle_shape(item.name, primitives([item])[0]))
    around = rng.uniform(-size, size, (20_000, 3)) + item.position
    inside = around[distance(item, around) == 0.0]
    deepest = (np.linalg.norm(inside[:, None] - balls[:, :3], axis=2) - balls[:, 3]).min(axis=1)
    assert len(inside) > 5
    assert deepest.max() < 1e-9
    assert len(balls) <= MOST_BALLS


@examples(0.6)
@given(st.sampled_from(KINDS), st.floats(0.01, 0.6), st.integers(0, 2**32 - 1))
def test_the_balls_stand_out_by_little(kind: str, size: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    item = random_object(kind, "thing", np.zeros(3), size, rng)
    balls = sphere_cover(obstacle_shape(item.name, primitives([item])[0]))
    directions = rng.normal(size=(500, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    surface = balls[:, :3] + balls[:, 3:] * directions[:, None]
    assert distance(item, surface.reshape(-1, 3)).max() < max(1.01 * STANDS_OUT, 0.16 * size)
