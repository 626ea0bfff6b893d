"""What an occupancy promises: no part of an object is outside its cells, and every cell holds some of one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from support.examples import examples
from zarm_contract.errors import Cancelled, InvalidRequest
from zarm_contract.messages import Capsule, Cuboid, Cylinder, Primitive, SceneObject, Sphere, Voxels
from zarm_geometry import packed_shapes
from zarm_geometry.occupancy import reached_cells
from zarm_geometry.world import World

SAMPLES = np.linspace(-0.5, 0.5, 9)
IN_A_CELL = np.stack(np.meshgrid(SAMPLES, SAMPLES, SAMPLES), axis=-1).reshape(-1, 3)
"""Points of a unit cube, none of whose is further from one than half the diagonal of their grid."""


def cells_of(*objects: SceneObject, resolution: float = 0.05) -> list[tuple[int, ...]]:
    return list(map(tuple, reached_cells(World(objects, 0.0), resolution, lambda: None).tolist()))


def primitives(count: int, seed: int) -> list[Primitive]:
    rng = np.random.default_rng(seed)
    items: list[Primitive] = []
    for i in range(count):
        turn = rng.normal(size=4)
        place = {
            "name": f"o{i}",
            "position": tuple(rng.uniform(-0.5, 0.5, 3).tolist()),
            "orientation": tuple((turn / np.linalg.norm(turn)).tolist()),
        }
        a, b, c = rng.uniform(0.002, 0.4, 3).tolist()
        items += [
            Cuboid(kind="cuboid", size=(a, b, c), **place),
            Capsule(kind="capsule", radius=a / 4, length=b, **place | {"name": f"c{i}"}),
            Cylinder(kind="cylinder", radius=a / 4, length=c, **place | {"name": f"d{i}"}),
            Sphere(kind="sphere", name=f"s{i}", position=place["position"], radius=b / 4),
        ]
    return items


@pytest.mark.lengthy
@examples(0.15)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.02, 0.05, 0.3]))
def test_no_point_of_an_object_is_outside_and_no_cell_is_empty(seed: int, resolution: float) -> None:
    world = World(primitives(1, seed), 0.0)
    cells = reached_cells(world, resolution, lambda: None)
    occupied = set(map(tuple, cells.tolist()))
    points = np.random.default_rng(seed).uniform(-0.9, 0.9, (20_000, 3))
    inside = points[packed_shapes.distances(points, world.rows).min(axis=1) < 0.0]
    assert {tuple(cell) for cell in np.rint(inside / resolution).astype(int).tolist()} <= occupied
    spacing = resolution * (SAMPLES[1] - SAMPLES[0])
    for cell in cells[:200]:
        held = packed_shapes.distances((cell + IN_A_CELL) * resolution, world.rows).min()
        assert held <= spacing * np.sqrt(3.0) / 2.0 + 1e-6


def test_a_box_along_the_grid_has_the_cells_that_it_fills() -> None:
    box = Cuboid(kind="cuboid", name="box", position=(0.5, 0.0, -0.5), size=(0.22, 0.08, 0.04))
    expected = [(i, j, -10) for i in range(8, 13) for j in (-1, 0, 1)]
    assert cells_of(box) == expected


@pytest.mark.parametrize("at", [(0.0, 0.0), (0.025, 0.025), (0.012, 0.025)])
def test_nothing_is_too_thin_to_be_seen(at: tuple[float, float]) -> None:
    wire = Cylinder(kind="cylinder", name="wire", position=(*at, 0.0), radius=0.0005, length=1.0)
    assert {k for _, _, k in cells_of(wire)} == set(range(-10, 11))


def test_objects_share_cells_and_voxels_are_objects_too() -> None:
    ball = Sphere(kind="sphere", name="ball", position=(0.0, 0.0, 0.0), radius=0.01)
    same = ball.model_copy(update={"name": "same"})
    voxels = Voxels(kind="voxels", name="voxels", resolution=0.04, cells=((0, 0, 0), (25, 0, 0)))
    assert cells_of() == []
    assert cells_of(ball, same) == [(0, 0, 0)]
    assert cells_of(ball, voxels) == [(0, 0, 0), (20, 0, 0)]


@pytest.mark.lengthy
def test_too_many_cells_are_refused_before_they_are_all_found() -> None:
    floor = Cuboid(kind="cuboid", name="floor", position=(0.0, 0.0, 0.0), size=(1000.0, 1000.0, 0.1))
    balls = tuple(Sphere(kind="sphere", name=f"b{i}", position=(i, 0.0, 0.0), radius=0.45) for i in range(10))
    for objects in ((floor,), balls):
        with pytest.raises(InvalidRequest) as raised:
            cells_of(*objects, resolution=0.02)
        assert raised.value.problem.field == "resolution"


def test_what_is_too_far_for_so_small_cells_is_refused() -> None:
    away = Sphere(kind="sphere", name="away", position=(900.0, 0.0, 0.0), radius=0.0005)
    assert cells_of(away, resolution=0.002) == [(450_000, 0, 0)]
    with pytest.raises(InvalidRequest) as raised:
        cells_of(away.model_copy(update={"position": (0.0, 1000.0, 0.0)}), resolution=0.002)
    assert raised.value.problem.field == "resolution"


def test_a_cancel_is_heard() -> None:
    def cancelled() -> None:
        raise Cancelled("enough")

    with pytest.raises(Cancelled):
        reached_cells(World(primitives(1, 0), 0.0), 0.05, cancelled)
