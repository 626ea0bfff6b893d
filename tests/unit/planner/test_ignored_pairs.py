"""Pairs whose collisions are ignored, and several edits at once."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from support.planner.second_opinion import link_pose
from support.planner.small_arm import small_arm
from zarm_contract.errors import InvalidRequest, PlanningFailed
from zarm_contract.messages import (
    MAX_PAIRED,
    AddObjects,
    AttachObject,
    ClearScene,
    DetachObject,
    EditBatch,
    JointGoal,
    PlanRequest,
    RemoveObjects,
    Scene,
    SceneEdit,
    SetPairCollision,
    SingleEdit,
    Sphere,
    Voxels,
)
from zarm_geometry.robot_model import RobotModel
from zarm_planner.handlers import Handlers
from zarm_planner.scene.store import SceneStore

UP = (0.0, 0.0, 0.0, 0.1)
ASIDE = (0.6, 0.0, 0.0, 0.1)


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> RobotModel:
    return RobotModel.of(small_arm(tmp_path_factory.mktemp("robot")))


@pytest.fixture
def store(arm: RobotModel, tmp_path: Path) -> SceneStore:
    return SceneStore(tmp_path, links=arm.links)


@pytest.fixture
def planner(arm: RobotModel, store: SceneStore) -> Iterator[Handlers]:
    planner = Handlers(arm, "small_arm", store, lambda: np.array(UP))
    yield planner
    planner.close()


def ball(name: str, x: float, y: float, z: float) -> Sphere:
    return Sphere(kind="sphere", name=name, position=(x, y, z), radius=0.02)


def at_tip(arm: RobotModel) -> Sphere:
    """A ball in the last link of the arm that is stretched upwards."""
    x, y, z = link_pose(arm.robot, "rod", np.array(UP))[:3, 3].tolist()
    return ball("ball", x, y, z)


def add(*objects: Sphere) -> AddObjects:
    return AddObjects(op="add", objects=objects)


def pairs(*named: tuple[str, str], enabled: bool = False) -> SetPairCollision:
    return SetPairCollision(op="pairs", names=named, enabled=enabled)


def single(edit: SingleEdit) -> SceneEdit:
    return SceneEdit(edit=edit)


def batch(*edits: SingleEdit) -> SceneEdit:
    return SceneEdit(edit=EditBatch(op="batch", edits=edits))


def plan(planner: Handlers) -> None:
    planner.plan(PlanRequest(goal=JointGoal(kind="joints", position=ASIDE), start=UP, timeout=5.0))


def test_plans_touch_what_a_pair_allows_and_nothing_else(arm: RobotModel, planner: Handlers) -> None:
    planner.edit(single(add(at_tip(arm))))
    with pytest.raises(PlanningFailed, match="ball"):
        plan(planner)
    planner.edit(single(pairs(("fore", "ball"))))
    with pytest.raises(PlanningFailed, match="ball"):
        plan(planner)
    planner.edit(single(pairs(("ball", "rod"))))
    plan(planner)
    planner.edit(single(pairs(("rod", "ball"), enabled=True)))
    with pytest.raises(PlanningFailed, match="ball"):
        plan(planner)


def test_a_carried_object_may_touch_what_a_pair_allows(arm: RobotModel, planner: Handlers) -> None:
    held, table = at_tip(arm), ball("table", *at_tip(arm).position)
    planner.edit(batch(add(held, table), AttachObject(op="attach", name="ball", joints=UP, touch_links=arm.links)))
    planner.edit(single(pairs(("rod", "table"))))
    with pytest.raises(PlanningFailed, match="table"):
        plan(planner)
    planner.edit(single(pairs(("ball", "table"))))
    plan(planner)


def test_a_link_may_touch_what_cameras_see(arm: RobotModel, planner: Handlers) -> None:
    x, y, z = at_tip(arm).position
    seen = Voxels(kind="voxels", name="map.0.0.0", position=(x, y, z), resolution=0.02, cells=((0, 0, 0),))
    planner.scenes.voxels = SimpleNamespace(objects={"map.0.0.0": seen})  # type: ignore[assignment]
    with pytest.raises(PlanningFailed, match="map"):
        plan(planner)
    scene = planner.edit(single(pairs(("rod", "map"))))
    assert scene.ignored_pairs == (("map", "rod"),)
    plan(planner)
    assert planner.edit(single(ClearScene(op="clear"))).ignored_pairs == (("map", "rod"),)


def test_a_pair_ends_with_its_object(arm: RobotModel, planner: Handlers) -> None:
    planner.edit(
        batch(
            add(at_tip(arm), ball("other", 1.0, 0.0, 0.0)), pairs(("rod", "ball"), ("rod", "other"), ("rod", "stand"))
        )
    )
    scene = planner.edit(single(RemoveObjects(op="remove", names=("ball",))))
    assert scene.ignored_pairs == (("other", "rod"), ("rod", "stand"))
    assert planner.edit(single(ClearScene(op="clear"))).ignored_pairs == (("rod", "stand"),)


@pytest.mark.parametrize(
    ("edit", "field", "says"),
    [
        (pairs(("rod", "ball"), ("rod", "nobody")), "edit.names.1", "nobody is neither a link .* nor an object"),
        (pairs(("ball", "other")), "edit.names.0", "never checked against each other"),
        (pairs(("rod", "rod")), "edit.names.0", "never checked against each other"),
        (pairs(*((f"b{k}", "rod") for k in range(MAX_PAIRED))), "edit.names", f"more than {MAX_PAIRED}"),
    ],
)
def test_a_faulty_pair_is_refused(
    arm: RobotModel, planner: Handlers, store: SceneStore, edit: SetPairCollision, field: str, says: str
) -> None:
    many = [ball(f"b{k}", 2.0, 0.1 * k, 0.0) for k in range(MAX_PAIRED)]
    before = planner.edit(single(add(at_tip(arm), ball("other", 1.0, 0.0, 0.0), *many)))
    with pytest.raises(InvalidRequest) as refused:
        planner.edit(single(edit))
    assert refused.value.problem.field == field
    assert re.search(says, refused.value.problem.message)
    assert store.scene == before


def test_a_batch_is_one_edit(arm: RobotModel, planner: Handlers) -> None:
    first = planner.edit(single(add(ball("old", 1.0, 0.0, 0.0))))
    scene = planner.edit(
        batch(
            RemoveObjects(op="remove", names=("old",)),
            add(at_tip(arm)),
            AttachObject(op="attach", name="ball", joints=UP),
            add(ball("new", 1.0, 0.0, 0.0)),
            DetachObject(op="detach", name="ball", joints=UP),
        )
    )
    assert [item.name for item in scene.objects] == ["new", "ball"]
    assert number(scene) == number(first) + 1
    np.testing.assert_allclose(scene.objects[1].position, at_tip(arm).position, atol=1e-9)


def test_a_batch_with_a_fault_changes_nothing(planner: Handlers, store: SceneStore) -> None:
    before = planner.edit(single(add(ball("old", 1.0, 0.0, 0.0))))
    with pytest.raises(InvalidRequest) as refused:
        planner.edit(batch(add(ball("new", 1.0, 0.0, 0.0)), RemoveObjects(op="remove", names=("old", "nobody"))))
    assert refused.value.problem.field == "edit.edits.1.names.1"
    assert store.scene == before


def number(scene: Scene) -> int:
    """How many edits a scene has had."""
    return int(scene.revision.partition("-")[0])
