"""What voxels promise: no point of a cloud is left out, and merged boxes are the cells, no more and no less."""

from __future__ import annotations

import json
from base64 import b64encode
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from zarm_contract.codec import decode, encode
from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import AddObjects, PointCloud, SceneEdit, Voxels
from zarm_geometry.voxels import FARTHEST_CELL, distinct, edges, merged, occupied, voxels_of
from zarm_geometry.world import World
from zarm_planner.scene.store import SceneStore

Cells = NDArray[np.int64]


def covered(low: Cells, high: Cells) -> list[tuple[int, ...]]:
    """Every cell of every box, as often as it is covered."""
    return sorted(
        tuple((first + np.array(step)).tolist())
        for first, last in zip(low, high, strict=True)
        for step in np.ndindex(*(last - first + 1))
    )


@pytest.mark.parametrize("resolution", [0.002, 0.02, 0.3])
def test_every_point_lies_in_a_box(resolution: float) -> None:
    rng = np.random.default_rng(0)
    points = np.concatenate([rng.normal(size=(500, 3)), resolution * (rng.integers(-9, 9, (500, 3)) + 0.5)])
    lower, upper = edges(*merged(occupied(points, resolution)), resolution)
    inside = np.all((points[:, None] >= lower - 1e-9) & (points[:, None] <= upper + 1e-9), axis=2)
    assert inside.any(axis=1).all()


def test_a_cell_is_occupied_once_and_only_where_a_point_is() -> None:
    assert occupied(np.array([(0.009, 0.0, -0.009), (0.0, 0.0, 0.0), (0.031, -0.011, 0.0)]), 0.02).tolist() == [
        [0, 0, 0],
        [2, -1, 0],
    ]


@pytest.mark.parametrize("count", [0, 1, 30, 3000])
def test_merged_boxes_cover_exactly_the_cells_each_once(count: int) -> None:
    cells = np.random.default_rng(count).integers(-8, 8, (count, 3))
    assert covered(*merged(cells)) == sorted(map(tuple, distinct(cells).tolist()))


def test_a_full_block_is_one_box_and_a_room_is_a_few() -> None:
    block = np.argwhere(np.ones((20, 30, 10), bool)) - 15
    assert [ends.tolist() for ends in merged(block)] == [[[-15, -15, -15]], [[4, 14, -6]]]
    kept_margin = np.ones((20, 30, 10), bool)
    kept_margin[1:-1, 1:-1, 1:-1] = False
    assert len(merged(np.argwhere(kept_margin))[0]) == 6


def test_the_furthest_cells_are_told_apart() -> None:
    ends = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * FARTHEST_CELL
    assert distinct(ends[::-1]).tolist() == ends.tolist()


def add(*items: PointCloud | Voxels) -> SceneEdit:
    return SceneEdit(edit=AddObjects(op="add", objects=items))


@pytest.mark.parametrize("axis", [1, 2])
def test_voxels_at_the_end_of_a_line_do_not_merge_with_the_next(axis: int) -> None:
    last, first = np.zeros((2, 3), np.int64)
    last[axis], first[axis], first[axis - 1] = FARTHEST_CELL, -FARTHEST_CELL, 1
    low, high = merged(np.array([last, first]))
    np.testing.assert_array_equal(low, [last, first])
    np.testing.assert_array_equal(high, [last, first])


@pytest.mark.parametrize(
    ("item", "field"),
    [
        (PointCloud(kind="cloud", name="seen", points=((0, 0, 0), (0, -1001, 0))), "edit.objects.0.points.1"),
        (Voxels(kind="voxels", name="seen", resolution=0.1, cells=((0, 0, 10_001),)), "edit.objects.0.cells.0"),
        (PointCloud(kind="cloud", name="seen", position=(0, 0, 2000), points=((0, 0, 0),)), "edit.objects.0.position"),
    ],
)
def test_what_is_too_far_away_is_refused_by_field(tmp_path: Path, item: PointCloud | Voxels, field: str) -> None:
    with pytest.raises(InvalidRequest, match="1000 m") as caught:
        SceneStore(tmp_path).edit(add(item))
    assert caught.value.problem.field == field


def test_a_scene_of_too_many_parts_or_bytes_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = SceneStore(tmp_path)
    one = Voxels(kind="voxels", name="one", resolution=0.1, cells=tuple((i, 0, 0) for i in range(60)))
    store.edit(add(one))
    other = one.model_copy(update={"name": "other"})
    monkeypatch.setattr("zarm_planner.scene.store.MAX_PARTS", 100)
    with pytest.raises(InvalidRequest, match="120 objects, cells and triangles"):
        store.edit(add(other))
    monkeypatch.setattr("zarm_planner.scene.store.MAX_PARTS", 1000)
    monkeypatch.setattr("zarm_planner.scene.store.MAX_BYTES", 1000)
    with pytest.raises(InvalidRequest, match="coarser resolution"):
        store.edit(add(other))
    assert store.scene.objects == (one,)
    assert SceneStore(tmp_path).scene.objects == (one,)


def test_a_cloud_becomes_voxels_in_its_own_frame(tmp_path: Path) -> None:
    turned = (0.0, 0.0, float(np.sqrt(0.5)), float(np.sqrt(0.5)))
    cloud = PointCloud(
        kind="cloud",
        name="seen",
        position=(1.0, 0.0, 0.0),
        orientation=turned,
        resolution=0.1,
        points=((0.5, 0.0, 0.0), (0.51, 0.0, 0.0)),
    )
    kept = SceneStore(tmp_path).edit(add(cloud))
    voxels = Voxels(
        kind="voxels", name="seen", position=(1.0, 0.0, 0.0), orientation=turned, resolution=0.1, cells=((5, 0, 0),)
    )
    assert kept.objects == (voxels,)
    assert SceneStore(tmp_path).scene == kept
    world = World(kept.objects, 0.0)
    assert world.names == ("seen",)
    box = world.arrays.boxes[0]
    np.testing.assert_allclose(box, (1.0, 0.5, 0.0, 0.05, 0.05, 0.05), atol=1e-6)


def test_a_packed_cloud_is_the_listed_one() -> None:
    points = np.random.default_rng(0).normal(size=(50, 3))
    packed = b64encode(points.astype("<f8").tobytes()).decode()
    listed = PointCloud(kind="cloud", name="seen", points=tuple(map(tuple, points.tolist())))
    cloud = PointCloud(kind="cloud", name="seen", points=packed)
    assert voxels_of(cloud, "") == voxels_of(listed, "")
    assert decode(PointCloud, encode(cloud)) == cloud


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"points": ()}, "at least 1 item"),
        ({"points": "not base64!"}, "not base64"),
        ({"points": b64encode(b"12345678" * 4).decode()}, "4 numbers are not"),
        ({"points": b64encode(np.full(3, np.nan).tobytes()).decode()}, "not a finite number"),
    ],
)
def test_a_cloud_without_whole_points_is_refused(fields: dict[str, object], says: str) -> None:
    payload = json.dumps({"kind": "cloud", "name": "seen"} | fields).encode()
    with pytest.raises(InvalidRequest, match=says):
        decode(PointCloud, payload)
