"""What the compiled collision checks promise: the same answers as plain numpy and FCL, and nothing missed on the way."""

from __future__ import annotations

import fcl
import numba
import numpy as np
import pytest

from support.planner.small_arm import small_arm
from support.planner.sphere_model import (
    clearances,
    distance,
    gaps_to_itself,
    gaps_to_objects,
    random_joints,
    random_object,
    random_objects,
)
from support.tiers import sampled
from zarm_contract.messages import Capsule, Cuboid, Cylinder, PlannerSettings, SceneObject, Sphere
from zarm_contract.robot import load_robot
from zarm_geometry.collision import is_free
from zarm_geometry.frames import rotation
from zarm_geometry.kernels.collision import RESOLUTION
from zarm_geometry.kernels.placing import sine_cosine
from zarm_geometry.kernels.simd import LANES, load, pointer, store
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.kernels.trees import Trees, add, make_trees, nearest_node
from zarm_trajectory.arrays import Single


@pytest.fixture(scope="module", params=sampled("panda", "doosan_m1013", "small_arm"))
def model(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> RobotModel:
    if request.param == "small_arm":
        return RobotModel.of(small_arm(tmp_path_factory.mktemp("robot")))
    return RobotModel.of(load_robot(request.param))


@pytest.fixture
def arm(tmp_path_factory: pytest.TempPathFactory) -> RobotModel:
    return RobotModel.of(small_arm(tmp_path_factory.mktemp("robot")))


def fcl_object(item: SceneObject) -> fcl.CollisionObject:
    if isinstance(item, Sphere):
        return fcl.CollisionObject(fcl.Sphere(item.radius), fcl.Transform(np.eye(3), np.array(item.position)))
    place = fcl.Transform(rotation(item.orientation), np.array(item.position))
    if isinstance(item, Cuboid):
        return fcl.CollisionObject(fcl.Box(*item.size), place)
    if isinstance(item, Capsule):
        return fcl.CollisionObject(fcl.Capsule(item.radius, item.length), place)
    assert isinstance(item, Cylinder)
    return fcl.CollisionObject(fcl.Cylinder(item.radius, item.length), place)


@pytest.mark.parametrize("kind", ["cuboid", "sphere", "capsule", "cylinder"])
def test_the_reference_distances_are_those_of_fcl(kind: str) -> None:
    rng = np.random.default_rng(0)
    for number in range(20):
        item = random_object(kind, f"thing{number}", rng.normal(size=3), 0.5, rng)
        points = rng.normal(size=(20, 3))
        radius = 0.01
        for point, expected in zip(points, distance(item, points), strict=True):
            ball = fcl.CollisionObject(fcl.Sphere(radius), fcl.Transform(np.eye(3), point))
            gap = fcl.distance(fcl_object(item), ball)
            if expected > radius + 1e-3:
                assert gap == pytest.approx(expected - radius, abs=1e-4)
            else:
                assert gap < 2e-3


@pytest.mark.lengthy
@pytest.mark.parametrize("count", [0, 1, 5, 60])
def test_a_configuration_is_free_exactly_when_no_sphere_touches(model: RobotModel, count: int) -> None:
    rng = np.random.default_rng(count)
    for _ in range(4):
        objects = random_objects(count, 0.3, rng)
        joints = random_joints(model, 100, rng)
        gaps = clearances(model, objects, joints)
        world = World(objects, 0.0)
        for q, gap in zip(joints, gaps, strict=True):
            if abs(gap) > 1e-5:
                assert is_free(model, world, q) == (gap > 0.0)


def test_the_margin_is_kept_to_objects(model: RobotModel) -> None:
    rng, margin = np.random.default_rng(1), 0.05
    objects, joints = random_objects(6, 0.3, rng), random_joints(model, 300, rng)
    gaps, alone = gaps_to_objects(model, objects, joints), gaps_to_itself(model, joints)
    kept = World(objects, margin)
    assert np.any((gaps > 0.0) & (gaps < margin) & (alone > 0.0))
    for q, gap, own in zip(joints, gaps, alone, strict=True):
        if abs(gap - margin) > 1e-5 and abs(own) > 1e-5:
            assert is_free(model, kept, q) == (gap > margin and own > 0.0)


@pytest.mark.lengthy
def test_thousands_of_objects_are_all_seen(model: RobotModel) -> None:
    rng = np.random.default_rng(2)
    objects, joints = random_objects(2000, 0.01, rng, 12.0), random_joints(model, 40, rng)
    parts = [World(objects[i : i + 3], 0.0) for i in range(0, len(objects), 3)]
    whole = World(objects, 0.0)
    answers = [is_free(model, whole, q) for q in joints]
    assert answers == [all(is_free(model, part, q) for part in parts) for q in joints]
    assert len(set(answers)) == 2


def test_links_on_the_base_meet_other_links_but_no_objects(arm: RobotModel) -> None:
    post = Sphere(kind="sphere", name="post", position=(-0.5, 0.0, 0.3), radius=0.02)
    assert is_free(arm, World((post,), 0.0), np.array([0.0, 0.5, 1.0, 0.1]))
    assert not is_free(arm, World((), 0.0), np.array([0.0, -1.54, 0.0, 0.0]))


@pytest.mark.lengthy
@pytest.mark.parametrize("count", sampled(15, 3))
def test_a_free_edge_penetrates_at_most_half_the_resolution(model: RobotModel, count: int) -> None:
    rng, samples = np.random.default_rng(count), 100
    free = blocked = 0
    for _ in range(4):
        objects = random_objects(count, 0.25, rng)
        world = World(objects, 0.0)
        for start, step in zip(random_joints(model, 12, rng), rng.normal(size=(12, model.dof)), strict=True):
            end = np.clip(start + 0.3 * step, model.lower, model.upper)
            gaps = clearances(model, objects, start + np.linspace(0.0, 1.0, samples)[:, None] * (end - start))
            between_samples = (np.abs(end - start) @ model.arrays.reach).max() / samples
            if is_free(model, world, np.array((start, end))):
                assert gaps.min() > -RESOLUTION / 2
                free += 1
            else:
                assert gaps.min() < between_samples
                blocked += 1
    assert min(free, blocked) > 3


def test_what_an_edge_check_misses_is_within_the_margin() -> None:
    assert PlannerSettings().margin >= RESOLUTION / 2


def test_a_pin_in_the_way_is_not_jumped_over(arm: RobotModel) -> None:
    start, end = np.array([-3.0, 1.2, 0.3, 0.2]), np.array([3.0, 1.2, 0.3, 0.2])
    for turn in np.linspace(-2.5, 2.5, 50):
        tip = arm.fk_tip(np.array([turn, 1.2, 0.3, 0.2]))[:3, 3]
        pin = Sphere(kind="sphere", name="pin", position=(tip[0], tip[1], tip[2]), radius=0.001)
        assert not is_free(arm, World((pin,), 0.0), np.array((start, end)))


@pytest.mark.lengthy
def test_on_a_long_way_no_link_passes_through_another(model: RobotModel) -> None:
    ends = random_joints(model, 120, np.random.default_rng(4)).reshape(-1, 2, model.dof)
    free = [edge for edge in ends if is_free(model, World((), 0.0), edge)]
    assert 3 < len(free) < len(ends)
    for start, end in free:
        way = start + np.linspace(0.0, 1.0, 300)[:, None] * (end - start)
        assert gaps_to_itself(model, way).min() > -RESOLUTION / 2


def test_a_path_is_free_when_each_of_its_edges_is(arm: RobotModel) -> None:
    plate = Cuboid(kind="cuboid", name="plate", position=(0.0, 0.6, 0.5), size=(0.001, 0.8, 1.0))
    world = World((plate,), 0.0)
    a, b, c = (np.array([turn, 1.2, 0.3, 0.2]) for turn in (-2.0, 0.0, 2.0))
    assert is_free(arm, world, np.array((a, b)))
    assert not is_free(arm, world, np.array((a, b, c)))


@numba.njit
def both(x: Single, s: Single, c: Single) -> None:
    """Sine and cosine of many."""
    for i in range(0, x.shape[0], LANES):
        sine, cosine = sine_cosine(load(pointer(x), i))
        store(pointer(s), i, sine)
        store(pointer(c), i, cosine)


@pytest.mark.lengthy
def test_sine_and_cosine_hold_over_two_turns() -> None:
    x = np.linspace(-2 * np.pi, 2 * np.pi, LANES * 1000).astype(np.float32)
    s, c = np.empty_like(x), np.empty_like(x)
    both(x, s, c)
    np.testing.assert_allclose(s, np.sin(x.astype(np.float64)), atol=1e-6)
    np.testing.assert_allclose(c, np.cos(x.astype(np.float64)), atol=1e-6)


@numba.njit
def find(trees: Trees, nodes: Single, target: Single, weight: Single) -> tuple[int, float]:
    """Plant a tree of `nodes` and look for the one nearest to `target`."""
    for i in range(nodes.shape[0]):
        add(trees, 1, nodes[i], i - 1)
    return nearest_node(trees, 1, target, weight)


@pytest.mark.lengthy
@pytest.mark.parametrize("count", sampled(333, 1, 16, 17))
def test_the_nearest_node_is_found(count: int) -> None:
    rng = np.random.default_rng(count)
    nodes = rng.uniform(-3, 3, (count, 5)).astype(np.float32)
    target, weight = rng.uniform(-3, 3, 5).astype(np.float32), rng.uniform(0.1, 2, 5).astype(np.float32)
    apart = np.linalg.norm((nodes - target) * weight, axis=1)
    index, least = find(make_trees(5), nodes, target, weight)
    assert index == np.argmin(apart)
    assert least == pytest.approx(apart.min(), rel=1e-5)
