"""What the robot carries is part of it, and links that are switched off are not: in spheres, exactly, and in the scene."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import trimesh

from support.planner.second_opinion import Collisions, link_pose
from support.planner.small_arm import small_arm
from support.planner.sphere_model import distance, random_joints, random_object, random_objects
from zarm_contract.errors import ExecutionRefused, InvalidRequest, Unavailable
from zarm_contract.messages import (
    MAX_ATTACHED,
    MAX_ATTACHED_PARTS,
    AddObjects,
    Attached,
    AttachObject,
    Capsule,
    CheckRequest,
    ClearScene,
    Cuboid,
    DetachObject,
    LoadScene,
    Mesh,
    RemoveObjects,
    Scene,
    SceneEdit,
    SceneObject,
    SetLinkCollision,
    Sphere,
    Voxels,
)
from zarm_geometry import packed_shapes
from zarm_geometry.body import attached_body
from zarm_geometry.collision import is_free
from zarm_geometry.exact import ExactScene
from zarm_geometry.frames import matrix
from zarm_geometry.meshes import Meshes
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.sphere_distances import sphere_distances
from zarm_geometry.world import World
from zarm_planner.handlers import Handlers
from zarm_planner.scene.store import SceneStore

KINDS = ("cuboid", "sphere", "capsule", "cylinder")
UP = np.array([0.0, 0.0, 0.0, 0.1])
"""The small arm stretched out, its tip 1 m above the base."""
ROD = Capsule(kind="capsule", name="pole", position=(0.0, 0.0, 0.25), radius=0.02, length=0.4)
"""In the frame of the tip: it goes on from there."""


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> RobotModel:
    return RobotModel.of(small_arm(tmp_path_factory.mktemp("robot")))


# -- a part of the robot --


def load(rng: np.random.Generator) -> Attached:
    kind, beyond = KINDS[rng.integers(4)], np.array([0.0, 0.0, 0.15])
    return Attached(object=random_object(kind, "load", beyond, 0.2, rng), touch_links=("fore", "cover"))


@pytest.mark.lengthy
@pytest.mark.parametrize("seed", range(8))
def test_what_is_carried_collides_where_it_is_carried(arm: RobotModel, seed: int) -> None:
    rng = np.random.default_rng(seed)
    attached, objects = (load(rng),), random_objects(2, 0.3, rng)
    scene = ExactScene(arm.with_attached(attached, ()), World(objects, 0.0))
    collisions = Collisions(arm.robot, objects, attached)
    answers = [(scene.nearest(q).distance <= 0.0, collisions.at(q)) for q in random_joints(arm, 60, rng)]
    assert all(found == expected for found, expected in answers)
    assert {found for found, _ in answers} == {True, False}


@pytest.mark.lengthy
@pytest.mark.parametrize("seed", range(8))
def test_what_is_free_in_spheres_is_free_exactly(arm: RobotModel, seed: int) -> None:
    rng = np.random.default_rng(seed)
    attached, objects = (load(rng),), random_objects(3, 0.2, rng)
    model = arm.with_attached(attached, ())
    collisions, world = Collisions(arm.robot, objects, attached), World(objects, 0.0)
    free = [q for q in random_joints(arm, 100, rng) if is_free(model, world, q)]
    assert len(free) > 3
    assert not any(collisions.at(q) for q in free)


def test_along_an_edge_too_nothing_is_hit_by_what_is_carried(arm: RobotModel) -> None:
    """The kernels skip what moves little: they must know how far a carried object reaches."""
    bend = np.array((UP - [0, 0.5, 0, 0], UP + [0, 0.5, 0, 0]))
    tip = link_pose(arm.robot, "rod", UP)
    x, y, z = (tip @ [0.0, 0.0, 0.4, 1.0])[:3].tolist()
    world = World((Sphere(kind="sphere", name="fly", position=(x, y, z), radius=0.005),), 0.0)
    assert is_free(arm, world, bend)
    assert not is_free(arm.with_attached((Attached(object=ROD),), ()), world, bend)


def test_a_collision_names_the_carried_object(arm: RobotModel) -> None:
    tip = link_pose(arm.robot, "rod", UP)
    x, y, z = (tip @ [0.0, 0.0, 0.4, 1.0])[:3].tolist()
    ball = Sphere(kind="sphere", name="ball", position=(x, y, z), radius=0.05)
    nearest = ExactScene(arm.with_attached((Attached(object=ROD),), ()), World((ball,), 0.0)).nearest(UP)
    assert nearest.pair == ("pole", "ball")
    assert nearest.distance == pytest.approx(-0.07, abs=1e-3)


def test_a_carried_object_touches_only_what_it_may(arm: RobotModel) -> None:
    long = Capsule(kind="capsule", name="pole", position=(0.0, 0.0, -0.2), radius=0.02, length=0.6)
    folded = np.array([0.0, 0.0, 0.0, 0.0])  # the pole runs back through cover, fore and upper
    hit = ExactScene(arm.with_attached((Attached(object=long),), ()), World((), 0.0)).nearest(folded)
    assert hit.pair is not None
    assert hit.distance < 0.0
    assert "pole" in hit.pair
    assert "rod" not in hit.pair
    touching = Attached(object=long, touch_links=("fore", "upper", "cover", "turret"))
    model = arm.with_attached((touching,), ())
    assert ExactScene(model, World((), 0.0)).nearest(folded).distance > 0.0
    others = {model.links[a] for a, b in model.pairs.tolist() if model.links[b] == "pole"}
    assert others == {"stand"}


def test_an_ignored_link_collides_with_nothing(arm: RobotModel) -> None:
    x, y, z = link_pose(arm.robot, "rod", UP)[:3, 3].tolist()
    ball = Sphere(kind="sphere", name="ball", position=(x, y, z), radius=0.02)
    world = World((ball,), 0.0)
    assert ExactScene(arm, World((ball,), 0.0)).nearest(UP).pair == ("rod", "ball")
    assert not is_free(arm, world, UP)
    model = arm.with_attached((), ("rod", "cover"))
    assert model.links == ("stand", "turret", "upper", "fore")
    assert ExactScene(model, World((ball,), 0.0)).nearest(UP).distance > 0.0
    assert is_free(model, world, UP)


def test_the_tip_is_where_it_was(arm: RobotModel) -> None:
    model, joints = (
        arm.with_attached((Attached(object=ROD),), ("cover",)),
        random_joints(arm, 5, np.random.default_rng(0)),
    )
    np.testing.assert_array_equal(model.fk_tip(joints), arm.fk_tip(joints))


# -- distances of spheres --


def test_distances_of_spheres_are_those_of_fcl(arm: RobotModel) -> None:
    rng = np.random.default_rng(0)
    objects = random_objects(12, 0.4, rng)
    world = World(objects, 0.02)
    balls = [(link, ball) for link, balls in arm.robot.descriptor.spheres.items() for ball in balls]
    outside = 0
    for q in random_joints(arm, 20, rng):
        distances = sphere_distances(arm, world, q)
        for (link, ball), found in zip(balls, distances, strict=True):
            center = (link_pose(arm.robot, link, q) @ [*ball.center, 1.0])[:3]
            expected = min(float(distance(item, center)) for item in objects) - ball.radius
            if expected > -ball.radius:
                outside += 1
                assert found == pytest.approx(min(expected, 1.0), abs=1e-9)
            else:
                assert found <= -ball.radius
    assert outside > 100


@pytest.mark.parametrize(
    ("item", "depth"),
    [
        (Cuboid(kind="cuboid", name="box", position=(0, 0, 0.06), size=(0.4, 0.6, 1.0)), 0.2),
        (Sphere(kind="sphere", name="ball", position=(0.1, 0, 0.06), radius=0.3), 0.2),
        (Capsule(kind="capsule", name="pill", position=(0.1, 0, 0.06), radius=0.25, length=1.0), 0.15),
    ],
)
def test_a_sphere_inside_an_object_is_as_deep_as_its_way_out(arm: RobotModel, item: SceneObject, depth: float) -> None:
    first = arm.robot.descriptor.spheres["stand"][0]
    assert first.center == (0.0, 0.0, 0.06)
    assert sphere_distances(arm, World((item,), 0.0), UP)[0] == pytest.approx(-depth - first.radius)


def test_without_objects_spheres_are_a_metre_away(arm: RobotModel) -> None:
    np.testing.assert_array_equal(sphere_distances(arm, World((), 0.0), UP), np.ones(10))


# -- the scene --


def unmeasured() -> np.ndarray:
    raise ExecutionRefused("no joint state was received", code="no_joint_state")


@pytest.fixture
def store(tmp_path: Path) -> SceneStore:
    return SceneStore(tmp_path)


@pytest.fixture
def planner(arm: RobotModel, store: SceneStore) -> Iterator[Handlers]:
    planner = Handlers(arm, "small_arm", store, unmeasured)
    yield planner
    planner.close()


BOX = Cuboid(
    kind="cuboid", name="box", position=(0.3, 0.1, 0.9), orientation=(0.6, 0.0, 0.0, 0.8), size=(0.1, 0.2, 0.3)
)
BALL = Sphere(kind="sphere", name="ball", position=(0.1, 0.2, 1.0), radius=0.05)


def add(*objects: SceneObject, replace: bool = False) -> SceneEdit:
    return SceneEdit(edit=AddObjects(op="add", objects=objects, replace=replace))


def test_an_edit_makes_ready_what_it_attaches(planner: Handlers) -> None:
    """The room between it and the links is measured before the edit holds, so that no plan waits for that."""
    planner.edit(add(BOX))
    planner.edit(SceneEdit(edit=AttachObject(op="attach", name="box", joints=tuple(UP.tolist()))))
    carrier = planner.scenes.present(0.005).exact.model
    assert "box" in carrier.links
    assert "pair_room" in vars(carrier)


def attach(name: str, *touch_links: str, at: np.ndarray | None = UP) -> SceneEdit:
    joints = None if at is None else tuple(at.tolist())
    return SceneEdit(edit=AttachObject(op="attach", name=name, touch_links=touch_links, joints=joints))


def detach(name: str, at: np.ndarray | None = UP) -> SceneEdit:
    return SceneEdit(edit=DetachObject(op="detach", name=name, joints=None if at is None else tuple(at.tolist())))


def links(*names: str, enabled: bool = False) -> SceneEdit:
    return SceneEdit(edit=SetLinkCollision(op="links", names=names, enabled=enabled))


@pytest.mark.parametrize("item", [BOX, BALL])
def test_an_object_goes_with_the_tip_and_stays_when_detached(
    arm: RobotModel, planner: Handlers, item: SceneObject
) -> None:
    away = np.array([1.0, 0.5, -0.7, 0.05])
    planner.edit(add(item))
    scene = planner.edit(attach(item.name, "fore"))
    assert scene.objects == ()
    assert scene.attached[0].touch_links == ("fore",)
    (put_down,) = planner.edit(detach(item.name, away)).objects
    moved = link_pose(arm.robot, "rod", away) @ np.linalg.inv(link_pose(arm.robot, "rod", UP))
    expected = moved @ pose(item)
    if isinstance(item, Sphere):
        expected[:3, :3] = np.eye(3)
    np.testing.assert_allclose(pose(put_down), expected, atol=1e-9)
    planner.edit(attach(item.name, at=away))
    (back,) = planner.edit(detach(item.name)).objects
    np.testing.assert_allclose(pose(back), pose(item), atol=1e-9)
    assert back.model_dump(exclude={"position", "orientation"}) == item.model_dump(exclude={"position", "orientation"})


def pose(item: SceneObject) -> np.ndarray:
    return matrix(item.position, (0.0, 0.0, 0.0, 1.0) if isinstance(item, Sphere) else item.orientation)


@pytest.mark.lengthy
@pytest.mark.parametrize(
    ("edit", "field", "says"),
    [
        (attach("nothing"), "edit.name", "no object nothing"),
        (attach("load"), "edit.name", "carries load already"),
        (attach("box", "upper", "finger"), "edit.touch_links.1", "finger is not a link .* stand, turret, upper"),
        (attach("rod"), "edit.name", "rod is a link"),
        (attach("box", at=UP[:3]), "edit.joints", "3 values for the 4 joints"),
        (detach("box"), "edit.name", "does not carry box; it carries load"),
        (add(BALL.model_copy(update={"name": "load"}), replace=True), "edit.objects.0.name", "carries load; detach it"),
        (
            SceneEdit(edit=LoadScene(op="load", objects=(BALL, BALL.model_copy(update={"name": "load"})))),
            "edit.objects.1.name",
            "carries load; detach it",
        ),
        (SceneEdit(edit=RemoveObjects(op="remove", names=("box", "load"))), "edit.names.1", "detach it"),
        (links("cover", "elbow"), "edit.names.1", "elbow is not a link .* stand, turret, upper"),
        (links("stand", "turret", "upper", "fore", "cover", "rod"), "edit.names", "collision checking for every link"),
    ],
)
def test_a_faulty_edit_is_refused_and_changes_nothing(
    planner: Handlers, store: SceneStore, edit: SceneEdit, field: str, says: str
) -> None:
    planner.edit(add(BOX, BALL.model_copy(update={"name": "rod"}), BALL.model_copy(update={"name": "load"})))
    before = planner.edit(attach("load"))
    with pytest.raises(InvalidRequest) as refused:
        planner.edit(edit)
    assert refused.value.problem.field == field
    assert re.search(says, refused.value.problem.message)
    assert store.scene == before


def ring(folder: Path) -> Mesh:
    trimesh.creation.torus(0.1, 0.03, major_sections=24, minor_sections=12).export(folder / "ring.stl")
    return Mesh(kind="mesh", name="part", position=(0.3, 0.1, 0.9), orientation=(0.6, 0.0, 0.0, 0.8), file="ring.stl")


def crumbs(_: Path) -> Voxels:
    cells = np.random.default_rng(1).integers(-9, 9, (200, 3))
    return Voxels(
        kind="voxels", name="part", position=(0.3, 0.1, 0.9), resolution=0.01, cells=tuple(map(tuple, cells.tolist()))
    )


@pytest.mark.parametrize("kind", [ring, crumbs])
def test_carried_meshes_and_voxels_become_cuboids(
    arm: RobotModel, tmp_path: Path, kind: Callable[[Path], Mesh | Voxels]
) -> None:
    store = SceneStore(tmp_path / "state", Meshes((tmp_path,)))
    tip = np.asarray(link_pose(arm.robot, "rod", UP), np.float64)
    item = kind(tmp_path)
    store.edit(add(item))
    shapes = World(store.scene.objects, 0.0, store.meshes).rows
    flat = shapes[:, 15] < 0.0
    points = np.concatenate(
        [packed_shapes.corners(shapes[flat]).reshape(-1, 3), np.mean(packed_shapes.bounds(shapes[~flat]), axis=0)]
    )
    carried = store.edit(attach("part"), lambda _, edit: (edit, tip)).attached[0]
    assert 0 < len(carried.parts) <= MAX_ATTACHED_PARTS

    parts = packed_shapes.placed(packed_shapes.primitives(carried.parts), tip)
    assert packed_shapes.distances(points, parts).min(axis=1).max() <= 1e-6
    body = attached_body(carried, arm.dof, tip)
    centers = body.balls[:, :3] @ tip[:3, :3].T + tip[:3, 3]
    assert (np.linalg.norm(points[:, None] - centers, axis=2) - body.balls[:, 3]).min(axis=1).max() <= 1e-6

    (put_down,) = store.edit(
        SceneEdit(edit=DetachObject(op="detach", name="part")), lambda _, edit: (edit, tip)
    ).objects
    assert put_down.position == pytest.approx(item.position)


@pytest.mark.parametrize("edit", [attach("box", at=None), detach("load", at=None)])
def test_attaching_needs_joints_or_a_measured_state(planner: Handlers, edit: SceneEdit) -> None:
    planner.edit(add(BOX, BALL.model_copy(update={"name": "load"})))
    planner.edit(attach("load"))
    with pytest.raises(ExecutionRefused) as refused:
        planner.edit(edit)
    assert refused.value.code == "no_joint_state"


@pytest.mark.lengthy
def test_a_robot_carries_a_limited_number_of_objects(planner: Handlers) -> None:
    planner.edit(add(*(BALL.model_copy(update={"name": f"b{i}"}) for i in range(MAX_ATTACHED + 1))))
    for i in range(MAX_ATTACHED):
        planner.edit(attach(f"b{i}"))
    with pytest.raises(InvalidRequest, match=str(MAX_ATTACHED)):
        planner.edit(attach(f"b{MAX_ATTACHED}"))


def test_clearing_and_loading_keep_attached_objects(planner: Handlers) -> None:
    planner.edit(add(BOX))
    planner.edit(attach("box"))
    carried = planner.edit(links("cover"))
    for edit in (ClearScene(op="clear"), LoadScene(op="load", objects=(BALL,))):
        scene = planner.edit(SceneEdit(edit=edit))
        assert (scene.attached, scene.ignored_links) == (carried.attached, ("cover",))
    assert scene.objects == (BALL,)


def test_links_are_switched_off_and_on_however_often_one_says_so(planner: Handlers) -> None:
    edits = (links("cover"), links("rod", "cover", "rod"), links("cover", enabled=True), links("cover", enabled=True))
    seen = [planner.edit(edit) for edit in edits]
    assert [scene.ignored_links for scene in seen] == [("cover",), ("cover", "rod"), ("rod",), ("rod",)]
    assert len({scene.revision for scene in seen}) == 4


def test_what_is_carried_and_ignored_outlives_the_process(planner: Handlers, tmp_path: Path) -> None:
    planner.edit(add(BOX))
    planner.edit(attach("box", "fore"))
    scene = planner.edit(links("cover"))
    assert SceneStore(tmp_path).scene == scene


def test_links_cannot_be_disabled_in_an_unknown_scene(tmp_path: Path) -> None:
    (tmp_path / "scene.json").write_text("broken")
    store = SceneStore(tmp_path)
    with pytest.raises(Unavailable, match=r"scene\.json\.broken"):
        store.edit(links("cover"))
    assert store.lost is not None
    assert store.edit(SceneEdit(edit=ClearScene(op="clear"))).ignored_links == ()
    assert store.edit(links("cover")).ignored_links == ("cover",)


def test_a_file_from_before_anything_could_be_carried_is_read(tmp_path: Path) -> None:
    old = {"revision": 7, "objects": [BALL.model_dump()]}
    (tmp_path / "scene.json").write_text(json.dumps({"format": 1, "scene": old}))
    scene = SceneStore(tmp_path).scene
    assert scene == Scene(revision=scene.revision, objects=(BALL,))


def test_checks_look_at_the_robot_as_it_is_in_the_scene(planner: Handlers) -> None:
    at_tip = BALL.model_copy(update={"position": (0.0, 0.0, 1.0)})
    near = Sphere(kind="sphere", name="near", position=at_tip.position, radius=0.2)
    request = CheckRequest(joints=(tuple(UP.tolist()),), spheres=True)
    planner.edit(add(at_tip))
    (before,) = planner.check(request).results
    assert before.pair == ("rod", "ball")
    planner.edit(attach("ball"))
    (carried,) = planner.check(request).results
    assert not carried.in_collision
    planner.edit(add(near))
    planner.edit(links("rod", "fore", "cover", "upper", "turret"))
    (hit,) = planner.check(request).results
    assert hit.pair == ("ball", "near")
    assert before.spheres is not None
    assert hit.spheres is not None
    assert carried.spheres == (1.0,) * len(before.spheres) != before.spheres
    assert len(hit.spheres) == len(before.spheres)
    assert hit.spheres[-1] < 0.0
