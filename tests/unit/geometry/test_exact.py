"""What the exact geometry promises: distances that hold against an independent computation, and nothing missed on the way."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from support.examples import examples
from support.planner.small_arm import small_arm
from zarm_contract.collision import CollisionCuboid, CollisionPrimitive, CollisionSphere
from zarm_contract.messages import Capsule, Cuboid, Cylinder, SceneObject, Sphere
from zarm_contract.robot import load_robot
from zarm_geometry.exact import MAX_CLEARANCE, ExactScene, robot_parts, subjects
from zarm_geometry.frames import matrix, rotation_to
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.shapes import Shape, distance, obstacle_shape
from zarm_geometry.world import World
from zarm_trajectory.arrays import Array

MARGIN = 0.005
"""Of the world; exact distances know nothing of it."""

FREE = np.array([0.0, 0.3, 0.4, 0.1])
"""A configuration of the small arm that touches nothing of itself."""


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> RobotModel:
    return RobotModel.of(small_arm(tmp_path_factory.mktemp("robot")))


def scene_of(model: RobotModel, objects: Sequence[SceneObject]) -> ExactScene:
    return ExactScene(model, World(objects, MARGIN))


def configuration(model: RobotModel, rng: np.random.Generator) -> Array:
    return rng.uniform(np.maximum(model.lower, -3), np.minimum(model.upper, 3))


def scene_object(rng: np.random.Generator, index: int, spread: float = 1.0) -> SceneObject:
    name, position = f"thing{index}", tuple(rng.uniform(-spread, spread, 3).tolist())
    q = rng.normal(size=4)
    orientation = tuple((q / np.linalg.norm(q)).tolist())
    radius, length = rng.uniform(0.01, 0.15), rng.uniform(0.01, 0.4)
    size = tuple(rng.uniform(0.02, 0.4, 3).tolist())
    kinds: list[SceneObject] = [
        Cuboid(kind="cuboid", name=name, position=position, orientation=orientation, size=size),
        Sphere(kind="sphere", name=name, position=position, radius=radius),
        Capsule(kind="capsule", name=name, position=position, orientation=orientation, radius=radius, length=length),
        Cylinder(kind="cylinder", name=name, position=position, orientation=orientation, radius=radius, length=length),
    ]
    return kinds[index % 4]


class Solid:
    """A convex solid that knows the nearest of its points: all that von Neumann's alternating projections need."""

    def __init__(self, kind: str, pose: Array, half: Sequence[float], radius: float) -> None:
        self.kind, self.pose, self.half, self.radius = kind, pose, np.array(half), radius

    def project(self, point: Array) -> Array:
        local = self.pose[:3, :3].T @ (point - self.pose[:3, 3])
        if self.kind == "cylinder":
            around = np.linalg.norm(local[:2])
            local[:2] *= min(1.0, self.radius / max(float(around), 1e-300))
            local[2] = np.clip(local[2], -self.half[2], self.half[2])
        else:
            core = np.clip(local, -self.half, self.half)
            away = float(np.linalg.norm(local - core))
            local = core + (local - core) * min(1.0, self.radius / max(away, 1e-300))
        nearest: Array = self.pose[:3, :3] @ local + self.pose[:3, 3]
        return nearest


def solid_of_object(item: SceneObject) -> Solid:
    if isinstance(item, Sphere):
        return Solid("sphere", matrix(item.position), (0, 0, 0), item.radius)
    pose = matrix(item.position, item.orientation)
    if isinstance(item, Cuboid):
        return Solid("cuboid", pose, [edge / 2 for edge in item.size], 0.0)
    return Solid(item.kind, pose, (0, 0, item.length / 2), item.radius)


def solid_of_link(item: CollisionPrimitive, link: Array) -> Solid:
    if isinstance(item, CollisionSphere):
        return Solid("sphere", link @ matrix(item.center), (0, 0, 0), item.radius)
    if isinstance(item, CollisionCuboid):
        return Solid("cuboid", link @ matrix(item.center, item.orientation), [edge / 2 for edge in item.size], 0.0)
    a, b = np.array(item.a), np.array(item.b)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation_to(b - a), (a + b) / 2
    return Solid(item.kind, link @ pose, (0, 0, float(np.linalg.norm(b - a)) / 2), item.radius)


def solid_of_shape(shape: Shape) -> Solid:
    return Solid("cylinder" if shape.disc else "other", shape.pose, shape.core.tolist(), shape.disc or shape.rounding)


def apart(one: Solid, other: Solid) -> float:
    """The distance of two solids (Cheney and Goldstein, "Proximity maps for convex sets", 1959)."""
    x, distance = one.pose[:3, 3], np.inf
    while True:
        y = other.project(x)
        x = one.project(y)
        if distance - (distance := float(np.linalg.norm(x - y))) < 1e-9:
            return distance


def truth(model: RobotModel, q: Array, objects: Sequence[SceneObject]) -> float:
    """The smallest distance of one configuration, from first principles."""
    collision = model.robot.descriptor.collision
    frames = model.link_transforms(q)
    solids = [[solid_of_link(item, frames[i]) for item in collision[link]] for i, link in enumerate(model.links)]
    pairs = [(a, b) for i, j in model.pairs for a, b in itertools.product(solids[i], solids[j])]
    for i, joint in enumerate(model.link_joint):
        if joint >= 0:
            pairs += itertools.product(solids[i], map(solid_of_object, objects))
    return min([MAX_CLEARANCE, *(apart(a, b) for a, b in pairs)])


@examples(0.25)
@given(seed=st.integers(0, 2**32 - 1))
def test_distance_is_that_of_alternating_projections(model: RobotModel, seed: int) -> None:
    rng = np.random.default_rng(seed)
    objects = [scene_object(rng, i) for i in range(8)]
    q = configuration(model, rng)
    assert max(0.0, scene_of(model, objects).nearest(q).distance) == pytest.approx(truth(model, q, objects), abs=1e-4)


def test_clearance_names_the_link_and_the_object_nearest_to_it(model: RobotModel) -> None:
    tip = model.fk_tip(FREE)[:3, 3]
    ball = Sphere(kind="sphere", name="ball", position=(tip[0], tip[1], tip[2] + 0.08), radius=0.02)
    nearest = scene_of(model, [ball]).nearest(FREE)
    assert nearest.pair == ("rod", "ball")
    assert nearest.distance == pytest.approx(0.08 - 0.02 - 0.03)


@pytest.mark.parametrize(
    ("item", "depth"),
    [
        (Sphere(kind="sphere", name="x", position=(0, 0, 0.04), radius=0.02), 0.01),
        (Cuboid(kind="cuboid", name="x", position=(0, 0, 0.06), size=(0.1, 0.1, 0.08)), 0.01),
        (Capsule(kind="capsule", name="x", position=(0, 0, 0.06), radius=0.04, length=0.01), 0.015),
        (Cylinder(kind="cylinder", name="x", position=(0, 0, 0.06), radius=0.05, length=0.08), 0.01),
    ],
)
def test_collision_tells_the_depth_of_penetration(model: RobotModel, item: SceneObject, depth: float) -> None:
    """The tip, a ball of 3 cm, reaches into what hangs above it; the rest of the arm is kept out of it by the slide."""
    q = np.array([0.0, np.pi / 2 - 0.3, 0.3, 0.2])
    offset = model.fk_tip(q)[:3, 3]
    item = item.model_copy(update={"position": tuple((np.array(item.position) + offset).tolist())})
    nearest = scene_of(model, [item]).nearest(q)
    assert nearest.pair == ("rod", "x")
    assert nearest.distance == pytest.approx(-depth, abs=1e-5)


def test_of_several_collisions_the_deepest_counts(model: RobotModel) -> None:
    tip = tuple(model.fk_tip(FREE)[:3, 3].tolist())
    balls = [Sphere(kind="sphere", name=f"ball{i}", position=tip, radius=0.01 * i) for i in range(1, 6)]
    nearest = scene_of(model, balls).nearest(FREE)
    assert nearest.distance == pytest.approx(-(0.03 + 0.05), abs=1e-5)


def test_the_fixed_base_may_stand_in_an_object(model: RobotModel) -> None:
    table = Cuboid(kind="cuboid", name="table", position=(0.0, 0.0, 0.0), size=(2.0, 2.0, 0.1))
    assert scene_of(model, [table]).nearest(FREE).distance > 0.0


def test_moving_links_meet_the_fixed_base(model: RobotModel) -> None:
    nearest = scene_of(model, []).nearest([np.pi, np.pi / 2, 0.0, 0.0])
    assert nearest.distance < 0.0
    assert nearest.pair is not None
    assert nearest.pair[1] == "stand"


def test_adjacent_and_rigidly_joined_links_are_left_out(model: RobotModel) -> None:
    """Fore arm, its cover and the rod overlap in every configuration."""
    assert scene_of(model, []).nearest(FREE).distance > 0.0


def test_nothing_near_is_the_farthest_clearance_without_a_pair(model: RobotModel) -> None:
    ball = Sphere(kind="sphere", name="ball", position=(9.0, 0.0, 0.0), radius=0.1)
    scene = scene_of(model, [ball])
    nearest = scene.nearest(FREE)
    assert nearest.pair is None or "ball" not in nearest.pair
    assert nearest.distance <= MAX_CLEARANCE


def dense(a: Array, b: Array, scene: ExactScene) -> Array:
    """From `a` to `b` in steps in which no point moves further than 5 mm."""
    return np.linspace(a, b, int(np.abs(b - a) @ scene.reach / 0.005) + 2)


@examples(0.2)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_motion_has_the_clearance_of_its_nearest_configuration(model: RobotModel, seed: int) -> None:
    rng = np.random.default_rng(seed)
    scene = scene_of(model, [scene_object(rng, i) for i in range(10)])
    start = configuration(model, rng)
    motion = dense(start, start + rng.uniform(-0.4, 0.4, model.dof) * (1, 1, 1, 0.2), scene)
    singly = [scene.nearest(q).distance for q in motion]
    found = scene.nearest(motion)
    if min(singly) <= 0.0:
        assert found.distance <= 0.0
        assert singly[found.sample] <= 0.0
    else:
        assert found.distance == pytest.approx(min(singly), abs=2e-5)


def test_exact_geometry_counts_where_spheres_leave_it_out(tmp_path: Path) -> None:
    robot = small_arm(tmp_path)
    dots = {
        link: tuple(ball.model_copy(update={"radius": 1e-3}) for ball in balls)
        for link, balls in robot.descriptor.spheres.items()
    }
    bare = RobotModel.of(replace(robot, descriptor=robot.descriptor.model_copy(update={"spheres": dots})))
    way = FREE + np.linspace(-0.5, 0.5, 40)[:, None] * (1, 1, 1, 0.1)
    tip = RobotModel.link_transforms(bare, way)[:, -1, :3, 3]
    rng = np.random.default_rng(3)
    for _ in range(100):  # balls near the start of the way and near its middle
        near = [tuple((tip[k] + rng.uniform(-0.12, 0.12, 3)).tolist()) for k in (0, 20)]
        scene = scene_of(
            bare, [Sphere(kind="sphere", name=f"ball{i}", position=at, radius=0.02) for i, at in enumerate(near)]
        )
        smallest = min(scene.nearest(q).distance for q in way)
        assert max(scene.nearest(way).distance, 0.0) == pytest.approx(max(smallest, 0.0), abs=2e-5)


@pytest.fixture(scope="module")
def panda() -> RobotModel:
    return RobotModel.of(load_robot("panda"))


@examples(0.2)
@given(seed=st.integers(0, 2**32 - 1))
def test_self_distance_along_a_motion_is_its_least(panda: RobotModel, seed: int) -> None:
    """Joints on the way turn both links about axes that may pass through either: what moves how far is the point of this."""
    rng = np.random.default_rng(seed)
    start, end = rng.uniform(panda.lower, panda.upper, (2, panda.dof))
    motion = start + np.linspace(0.0, rng.uniform(0.1, 1.0), 300)[:, None] * (end - start)
    scene = ExactScene(panda, World((), 0.0))
    singly = [scene.nearest(q).distance for q in motion]
    found = scene.nearest(motion)
    if min(singly) <= 0.0:
        assert singly[found.sample] <= 0.0
    else:
        assert found.distance == pytest.approx(min(singly), abs=2e-5)


@examples(0.5)
@given(seed=st.integers(0, 2**32 - 1))
def test_free_is_what_is_nowhere_nearer_than_nothing(model: RobotModel, seed: int) -> None:
    rng = np.random.default_rng(seed)
    scene = scene_of(model, [scene_object(rng, i) for i in range(6)])
    start = configuration(model, rng)
    motion = dense(start, start + rng.uniform(-0.2, 0.2, model.dof) * (1, 1, 1, 0.2), scene)
    assert scene.is_free(start) == (scene.nearest(start).distance > 0.0)
    assert scene.is_free(motion) == (scene.nearest(motion).distance > 0.0)


def measured(model: RobotModel, motion: Array, objects: Sequence[SceneObject]) -> Array:
    """FCL's smallest distance (n,) at each configuration (n, dof), of every two shapes that can meet; 0 in collision."""
    rows = World(objects, MARGIN).rows
    obstacles = [obstacle_shape("thing", row) for row in rows]
    can_meet = {tuple(pair) for pair in model.pairs.tolist()}
    smallest = np.full(len(motion), MAX_CLEARANCE)
    for n, q in enumerate(motion):
        frames = model.link_transforms(q)
        parts = [(link, shape, frames[link] @ shape.pose) for link, shape in model.parts]
        for link, shape, pose in parts:
            others = [(other, at) for other_link, other, at in parts if (other_link, link) in can_meet]
            if model.link_joint[link] >= 0:
                others += [(other, other.pose) for other in obstacles]
            for other, at in others:
                smallest[n] = min(smallest[n], max(0.0, distance(shape, pose, other, at)))
    return smallest


@examples(0.1)
@given(seed=st.integers(0, 2**32 - 1))
def test_motion_distance_is_never_more_than_fcl_measures(model: RobotModel, seed: int) -> None:
    """Every two shapes at every configuration, none left out by a bound; coarse motions too, which leave nothing to luck."""
    rng = np.random.default_rng(seed)
    objects = [scene_object(rng, i) for i in range(4)]
    start = configuration(model, rng)
    motion = np.linspace(start, start + rng.uniform(-1.0, 1.0, model.dof) * (1, 1, 1, 0.1), 25)
    found, everywhere = scene_of(model, objects).nearest(motion), measured(model, motion, objects)
    assert found.distance <= everywhere.min() + 1e-5
    if everywhere.min() <= 0.0:
        assert everywhere[found.sample] <= 0.0


@examples(0.2)
@given(seed=st.integers(0, 2**32 - 1))
def test_bounds_enclose_the_distance(model: RobotModel, seed: int) -> None:
    """By two other computations. FCL is never too short; but of capsules or cylinders and boxes 1 in 1000 is too long."""
    rng = np.random.default_rng(seed)
    world = World([scene_object(rng, i) for i in range(4)], MARGIN)
    q = configuration(model, rng)
    frames = model.link_transforms(q)
    everything = subjects(model, robot_parts(model)[0])
    bounds = ExactScene(model, world).bounds(q[None], lambda: None, everything)
    assert len(bounds)
    for lower, upper, part, other, _ in bounds.tolist():
        link, shape = model.parts[int(part)]
        shape = replace(shape, pose=frames[link] @ shape.pose)
        if other >= 0:
            obstacle = obstacle_shape("thing", world.rows[int(other)])
        else:
            other_link, obstacle = model.parts[-1 - int(other)]
            obstacle = replace(obstacle, pose=frames[other_link] @ obstacle.pose)
        assert lower <= distance(shape, shape.pose, obstacle, obstacle.pose) + 1e-5
        assert apart(solid_of_shape(shape), solid_of_shape(obstacle)) <= max(upper, 0.0) + 1e-4


@examples(0.2)
@given(seed=st.integers(0, 2**32 - 1))
def test_no_sheet_of_5_mm_is_missed_on_the_way(model: RobotModel, seed: int) -> None:
    rng = np.random.default_rng(seed)
    a = FREE.copy()
    b = FREE + np.array([rng.choice([-1, 1]) * rng.uniform(1.0, 3.0), 0, 0, 0])
    between = model.fk_tip(a + rng.uniform(0.3, 0.7) * (b - a))
    across = between[:3, :3] @ (1.0, 0.0, 0.0)
    turn = np.eye(3)
    turn[:, 0], turn[:, 1] = (-across[1], across[0], 0.0), (across[0], across[1], 0.0)
    sheet = Cuboid(
        kind="cuboid",
        name="sheet",
        position=tuple(between[:3, 3].tolist()),
        orientation=(0.0, 0.0, *_half_turn(turn)),
        size=(0.005, 0.1, 0.1),
    )
    scene = scene_of(model, [sheet])
    assert scene.nearest(a).distance > 0.0
    assert scene.nearest(b).distance > 0.0
    assert scene.nearest(dense(a, b, scene)).distance <= 0.0


def _half_turn(turn: Array) -> tuple[float, float]:
    angle = float(np.arctan2(turn[1, 0], turn[0, 0])) / 2
    return float(np.sin(angle)), float(np.cos(angle))


@examples(0.3)
@given(seed=st.integers(0, 2**32 - 1))
def test_no_point_moves_further_than_its_reach(model: RobotModel, seed: int) -> None:
    rng = np.random.default_rng(seed)
    scene = scene_of(model, [])
    q = configuration(model, rng)
    step = rng.normal(size=model.dof) * rng.uniform(1e-4, 0.3)
    before, after = model.link_transforms(q), model.link_transforms(q + step)
    for i, link in enumerate(model.links):
        for item in model.robot.descriptor.collision[link]:
            solid = solid_of_link(item, np.eye(4))
            points = np.array([solid.project(p) for p in rng.normal(size=(20, 3)) * 10])
            moved = points @ (after[i] - before[i])[:3, :3].T + (after[i] - before[i])[:3, 3]
            assert np.linalg.norm(moved, axis=1).max() <= np.abs(step) @ scene.reach + 1e-9


def test_thousands_of_objects_give_the_distance_of_the_nearest(model: RobotModel) -> None:
    rng = np.random.default_rng(1)
    far = [scene_object(rng, i, spread=40.0) for i in range(5000)]
    far = [item for item in far if np.linalg.norm(item.position) > 3.0]
    near = [Sphere(kind="sphere", name="near", position=(0.5, 0.5, 0.9), radius=0.05)]
    alone, crowded = scene_of(model, near), scene_of(model, [*far, *near])
    motion = dense(FREE - (0.5, 0, 0, 0), FREE + (0.5, 0, 0, 0), alone)
    assert crowded.nearest(motion) == alone.nearest(motion)


@pytest.mark.parametrize("margin", [0.0, 0.005, 0.2])
def test_no_margin_counts_in_exact_distances(model: RobotModel, margin: float) -> None:
    rng = np.random.default_rng(2)
    objects = [scene_object(rng, i) for i in range(8)]
    motion = dense(FREE, FREE + (1.0, 0.2, 0.0, 0.0), scene_of(model, objects))
    assert ExactScene(model, World(objects, margin)).nearest(motion) == scene_of(model, objects).nearest(motion)


def test_an_object_as_wide_as_the_world_is_as_near_as_it_is(model: RobotModel) -> None:
    """The tree of boxes is in single precision, which tells 999.999 m from 1000 m by a hair only."""
    top = float(model.fk_tip(FREE)[2, 3]) + 0.03
    size = 999.7
    ceiling = Cuboid(kind="cuboid", name="ceiling", position=(0.0, 0.0, top + 0.0123 + size / 2), size=(size,) * 3)
    nearest = scene_of(model, [ceiling]).nearest(FREE)
    assert nearest.pair == ("rod", "ceiling")
    assert nearest.distance == pytest.approx(0.0123, abs=1e-5)


def test_a_stop_ends_the_look_along_a_motion(model: RobotModel) -> None:
    def stop() -> None:
        raise InterruptedError

    with pytest.raises(InterruptedError):
        scene_of(model, []).nearest(np.linspace(FREE, FREE + 0.1, 100), stop)


def test_nothing_is_near_where_no_configuration_is_given(model: RobotModel) -> None:
    scene, none = (
        scene_of(model, [Sphere(kind="sphere", name="ball", position=(0.3, 0.0, 0.3), radius=0.1)]),
        np.empty((0, model.dof)),
    )
    assert scene.is_free(none)
    assert scene.nearest(none).distance == MAX_CLEARANCE
