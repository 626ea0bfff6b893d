"""Pairs of a link and an object that may touch: all other pairs are checked as before, by every check there is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from support.composed import torso_with_arms
from support.planner.small_arm import small_arm
from support.planner.sphere_model import random_joints, random_objects
from zarm_contract.messages import SceneObject, Sphere
from zarm_contract.robot import load_robot
from zarm_geometry.allowed_collisions import Pairs, partners
from zarm_geometry.collision import is_free
from zarm_geometry.exact import ExactScene
from zarm_geometry.motion_check import MotionCheck
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.situation import MovingObject
from zarm_geometry.world import World
from zarm_trajectory.arrays import Array

MARGIN = 0.005
TIMES = np.linspace(0.0, 2.0, 60)


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> RobotModel:
    return RobotModel.of(small_arm(tmp_path_factory.mktemp("robot")))


class Case:
    """Random objects, and random pairs of them and links that may touch."""

    def __init__(self, arm: RobotModel, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.arm, self.objects = arm, random_objects(4, 0.5, self.rng)
        chosen = [(link, item.name) for link in arm.links for item in self.objects if self.rng.random() < 0.3]
        self.pairs: Pairs = tuple(chosen)
        self.robot = arm.with_attached((), (), (), self.pairs)
        self.world = World(self.objects, 0.0).with_allowed(self.pairs)

    def each(self) -> list[tuple[RobotModel, World]]:
        """Each object alone, and the links that may not touch it."""
        return [(self.arm.with_attached((), [*self.ignored(item)]), World((item,), 0.0)) for item in self.objects]

    def ignored(self, item: SceneObject) -> frozenset[str]:
        return partners(item.name, self.pairs)


@pytest.mark.parametrize("seed", range(12))
def test_exact_distances_leave_out_allowed_pairs(arm: RobotModel, seed: int) -> None:
    case = Case(arm, seed)
    scene, each = ExactScene(case.robot, case.world), [ExactScene(*one) for one in case.each()]
    for q in random_joints(arm, 10, case.rng):
        found, expected = scene.nearest(q, itself=False), min(one.nearest(q, itself=False).distance for one in each)
        assert found.distance == pytest.approx(expected, abs=1e-4)
        assert found.pair is None or tuple(found.pair) not in case.pairs
    for _ in range(5):
        motion = np.linspace(*random_joints(arm, 2, case.rng), 200)
        clear = [one.nearest(motion, itself=False).distance for one in each]
        found = scene.nearest(motion, itself=False)
        assert (found.distance > 0.0) == (min(clear) > 0.0)
        if found.distance > 0.0:
            assert found.distance == pytest.approx(min(clear), abs=1e-4)


@pytest.mark.parametrize("seed", range(12))
def test_spheres_leave_out_allowed_pairs(arm: RobotModel, seed: int) -> None:
    case = Case(arm, seed)
    for k in range(60):
        q = random_joints(arm, 1 + k % 2, case.rng)
        alone = is_free(arm, World((), 0.0), q)
        assert is_free(case.robot, case.world, q) == (alone and all(is_free(*one, q) for one in case.each()))


@pytest.mark.parametrize("moving", [False, True])
@pytest.mark.parametrize("seed", range(6))
def test_motion_checks_leave_out_allowed_pairs(arm: RobotModel, seed: int, moving: bool) -> None:
    case, check = Case(arm, seed), MotionCheck(arm)
    movers = [MovingObject(item, speed=0.01) for item in case.objects] if moving else []
    if not moving:
        check.set_world(World(case.objects[:2], 0.0))
        check.update(case.objects[2:])

    def free(motion: Array, ignored: frozenset[str], item: SceneObject) -> bool:
        alone = MotionCheck(arm)
        alone.update([] if moving else [item])
        return alone.check(
            TIMES, motion, margin=MARGIN, ignored_links=[*ignored], self_collision=False,
            moving=[mover for mover in movers if mover.object is item],
        ).free  # fmt: skip

    for _ in range(6):
        motion = np.linspace(*random_joints(arm, 2, case.rng), len(TIMES))
        found = check.check(TIMES, motion, margin=MARGIN, moving=movers, allowed=case.pairs, self_collision=False)
        assert found.free == all(free(motion, case.ignored(item), item) for item in case.objects)
        assert (found.link, found.object) not in case.pairs
        near = {(one.link, one.object) for one in check.nearby(motion[0], within=0.5, moving=movers)}
        kept = {
            (one.link, one.object) for one in check.nearby(motion[0], within=0.5, moving=movers, allowed=case.pairs)
        }
        assert kept == near - {*case.pairs}


def test_links_that_may_touch_each_other_are_no_pair(arm: RobotModel) -> None:
    def pairs(model: RobotModel) -> set[frozenset[str]]:
        return {frozenset((model.links[a], model.links[b])) for a, b in model.pairs.tolist()}

    allowed = arm.with_attached((), (), (), (("rod", "stand"),))
    assert pairs(arm) - pairs(allowed) == {frozenset(("rod", "stand"))}


def test_a_group_knows_the_pairs_of_its_robot(tmp_path: Path) -> None:
    whole = RobotModel.of(load_robot(str(torso_with_arms(tmp_path))))
    link = whole.links[-1]
    model = whole.with_attached((), (), (), ((link, "box"),))
    (name, *_) = [
        name for name in whole.robot.descriptor.groups if link in model.group([name], np.zeros(whole.dof)).links
    ]
    group = model.group([name], np.zeros(whole.dof))
    assert group.allowed == model.allowed
    assert group.arrays.bit[group.links.index(link)] == model.arrays.bit[model.links.index(link)] != 1


def test_a_robot_and_a_world_of_other_pairs_do_not_go_together(arm: RobotModel) -> None:
    ball = Sphere(kind="sphere", name="ball", position=(0.3, 0.0, 0.3), radius=0.05)
    with pytest.raises(ValueError, match="ball"):
        ExactScene(
            arm.with_attached((), (), (), (("rod", "ball"),)), World((ball,), 0.0).with_allowed((("fore", "ball"),))
        )
