"""No plan waits for what has changed: an edit makes the whole scene ready, and of that only what it changed."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from support.planner.small_arm import small_arm
from zarm_contract.messages import (
    AddObjects,
    AttachObject,
    CheckRequest,
    ClearScene,
    Cuboid,
    DetachObject,
    ObjectPose,
    RemoveObjects,
    SceneEdit,
    SetLinkCollision,
    SettingsChange,
    Voxels,
)
from zarm_geometry import box_tree
from zarm_geometry.robot_model import RobotModel
from zarm_planner.handlers import Handlers
from zarm_planner.scene import scene_cache
from zarm_planner.scene.store import SceneStore

JOINTS = (0.0, 0.3, 0.4, 0.1)
BOX = Cuboid(kind="cuboid", name="box", position=(0.9, 0.0, 0.5), size=(0.1, 0.1, 0.1))
CELLS = tuple((20, i, j) for i in range(0, 40, 2) for j in range(0, 40, 2))
CLOUD = Voxels(kind="voxels", name="cloud", resolution=0.05, cells=CELLS)
EDITS = {
    "add": AddObjects(op="add", objects=(BOX.model_copy(update={"name": "other"}),)),
    "replace": AddObjects(op="add", objects=(CLOUD.model_copy(update={"position": (0.1, 0.0, 0.0)}),), replace=True),
    "remove": RemoveObjects(op="remove", names=("cloud",)),
    "clear": ClearScene(op="clear"),
    "attach": AttachObject(op="attach", name="box", joints=JOINTS),
    "links": SetLinkCollision(op="links", names=("cover",), enabled=False),
}


@pytest.fixture
def planner(tmp_path: Path) -> Iterator[Handlers]:
    planner = Handlers(
        RobotModel.of(small_arm(tmp_path)), "small_arm", SceneStore(tmp_path / "state"), lambda: np.array(JOINTS)
    )
    planner.edit(SceneEdit(edit=AddObjects(op="add", objects=(BOX, CLOUD))))
    yield planner
    planner.close()


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many objects each world has that was made since."""
    counts: list[int] = []

    class Counted(scene_cache.World):
        def __init__(self, objects: object, *rest: object) -> None:
            counts.append(len(objects))  # type: ignore[arg-type]
            super().__init__(objects, *rest)  # type: ignore[arg-type]

    monkeypatch.setattr(scene_cache, "World", Counted)
    return counts


@pytest.fixture
def split(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many shapes each tree has that was built since."""
    counts: list[int] = []
    median_split = box_tree.median_split

    def counted(points: box_tree.Array, branches: int) -> object:
        counts.append(len(points))
        return median_split(points, branches)

    monkeypatch.setattr(box_tree, "median_split", counted)
    return counts


def nearest(planner: Handlers) -> float:
    """Exact distance (m) at JOINTS in the present scene."""
    (result,) = planner.check(CheckRequest(joints=(JOINTS,))).results
    return result.clearance


@pytest.mark.parametrize("edit", EDITS)
def test_an_edit_makes_ready_all_that_plans_need(planner: Handlers, made: list[int], edit: str) -> None:
    scene = planner.edit(SceneEdit(edit=EDITS[edit]))
    assert made == [len(scene.objects)]
    nearest(planner)
    planner.change_settings(SettingsChange(margin=0.02))
    nearest(planner)
    assert len(made) == 1


def test_what_is_put_down_is_ready_too(planner: Handlers, made: list[int]) -> None:
    planner.edit(SceneEdit(edit=EDITS["attach"]))
    before = nearest(planner)
    planner.edit(SceneEdit(edit=DetachObject(op="detach", name="box", joints=JOINTS)))
    made.clear()
    assert nearest(planner) != pytest.approx(before, abs=1e-3) or before < 1.0
    assert not made


def test_of_a_scene_only_what_changed_is_built_anew(planner: Handlers, split: list[int]) -> None:
    planner.edit(SceneEdit(edit=EDITS["add"]))
    assert split == [2, 2]  # the two boxes, and the two trees over all, not the cloud
    planner.scenes.moved.receive(
        "zarm/small_arm/scene/object/box/pose", ObjectPose(stamp=1.0, position=(0.5, 0.0, 0.5), speed=0.0)
    )
    nearest(planner)
    assert split == [2, 2, 2, 2]


def test_a_moved_object_stays_moved_after_another_edit(planner: Handlers, made: list[int]) -> None:
    far = nearest(planner)
    planner.scenes.moved.receive(
        "zarm/small_arm/scene/object/box/pose", ObjectPose(stamp=1.0, position=(0.1, 0.0, 0.6), speed=0.0)
    )
    near = nearest(planner)
    assert near < far
    made.clear()
    planner.edit(SceneEdit(edit=EDITS["add"]))
    assert nearest(planner) == near
    assert len(made) == 1


def test_each_request_gets_the_scene_with_its_own_margins(planner: Handlers) -> None:
    asked = [(0.01, 0.0), (0.02, 0.0), (0.02, 0.03), (0.01, 0.0)]
    found = [planner.scenes.present(*margins) for margins in asked]
    assert [(scene.world.margin, scene.self_margin) for scene in found] == asked
    assert [float(scene.world.arrays.margin) for scene in found] == [margin for margin, _ in asked]
    assert [bool(scene.model.arrays.apart.any()) for scene in found] == [False, False, True, False]
    assert planner.scenes.present(*asked[-1]) is found[-1]
