"""What batches of kinematics promise: on every device the kernels' own answers, and torch only where it is asked for."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from support.planner.small_arm import small_arm
from support.planner.sphere_model import random_joints
from support.planner.unchecked_pairs import JOINTS, unchecked_pairs
from support.tiers import sampled
from zarm_contract.errors import Cancelled, InvalidRequest
from zarm_contract.messages import CheckRequest, Device, IkRequest, Sphere
from zarm_contract.robot import load_robot
from zarm_geometry.collision import is_free
from zarm_geometry.exact import ExactScene
from zarm_geometry.frames import pose_of
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.deadline import Deadline
from zarm_planner.handlers import Handlers
from zarm_planner.kinematics import batches
from zarm_planner.kinematics.batches import WORTH_A_GPU, batch_fk, batch_ik
from zarm_planner.scene.store import SceneStore
from zarm_trajectory.arrays import Array

ROBOTS = ("doosan_m1013", "panda", "ur5e", "ur10e", "small_arm")


@pytest.fixture(scope="module", params=sampled(*ROBOTS))
def model(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> RobotModel:
    if request.param == "small_arm":
        return RobotModel.of(small_arm(tmp_path_factory.mktemp("robot")))
    return RobotModel.of(load_robot(request.param))


@pytest.fixture(scope="module")
def ur5e() -> RobotModel:
    return RobotModel.of(load_robot("ur5e"))


def solved(
    model: RobotModel, poses: Array, near: Array, device: Device, most: int = 1, world: World | None = None
) -> list[Array]:
    return batch_ik(model, poses, near, world=world, max_solutions=most, seed=3, device=device, deadline=Deadline(60.0))


@pytest.mark.lengthy
def test_poses_on_torch_are_those_of_the_kernels(model: RobotModel) -> None:
    joints = random_joints(model, 100, np.random.default_rng(0))
    np.testing.assert_allclose(batch_fk(model, joints, "cpu"), batch_fk(model, joints, "kernels"), rtol=0, atol=1e-6)


@pytest.mark.lengthy
def test_torch_solutions_satisfy_the_kernels_nearest_first(model: RobotModel) -> None:
    joints = random_joints(model, 6, np.random.default_rng(1))
    poses, near = model.fk_tip(joints), np.array(model.robot.descriptor.home)
    for pose, rows in zip(poses, solved(model, poses, near, "cpu", most=4), strict=True):
        assert len(rows) > 0
        np.testing.assert_allclose(model.fk_tip(rows), np.broadcast_to(pose, (len(rows), 4, 4)), rtol=0, atol=1e-6)
        assert np.all((rows >= model.lower) & (rows <= model.upper))
        assert np.all(np.diff(np.linalg.norm(rows - near, axis=1)) >= 0.0)
        apart = np.abs(rows[:, None] - rows[None]).max(axis=2) + np.eye(len(rows))
        assert apart.min() > 0.09


@pytest.mark.lengthy
def test_torch_leaves_little_to_the_kernels(ur5e: RobotModel, monkeypatch: pytest.MonkeyPatch) -> None:
    by_kernels = []
    solve_ik = batches.solve_ik

    def counted(*arguments: object, **options: object) -> object:
        by_kernels.append(arguments)
        return solve_ik(*arguments, **options)

    monkeypatch.setattr(batches, "solve_ik", counted)
    poses = ur5e.fk_tip(random_joints(ur5e, 50, np.random.default_rng(2)))
    found = solved(ur5e, poses, np.zeros(6), "cpu")
    assert all(len(rows) == 1 for rows in found)
    assert len(by_kernels) < 5


def test_a_pose_near_the_seed_is_solved_near_it_on_every_device(ur5e: RobotModel) -> None:
    home = np.array(ur5e.robot.descriptor.home)
    for device in ("kernels", "cpu"):
        [rows] = solved(ur5e, ur5e.fk_tip(home + 0.05)[None], home, device)
        np.testing.assert_allclose(rows, [home + 0.05], atol=1e-3)


def test_solutions_on_torch_are_free_of_the_world(ur5e: RobotModel) -> None:
    home = np.array(ur5e.robot.descriptor.home)
    pose = ur5e.fk_tip(home + 0.3)
    x, y, z = ur5e.link_transforms(home + 0.3)[ur5e.links.index("forearm_link"), :3, 3].tolist()
    world = World((Sphere(kind="sphere", name="ball", position=(x, y, z), radius=0.05),), 0.0)
    [rows] = solved(ur5e, pose[None], home, "cpu", most=8, world=world)
    assert len(rows) > 0
    assert all(is_free(ur5e, world, q) for q in rows)
    [everything] = solved(ur5e, pose[None], home, "cpu", most=8)
    assert not all(is_free(ur5e, world, q) for q in everything)


def test_a_pose_out_of_reach_has_no_solution_on_any_device(ur5e: RobotModel) -> None:
    pose = np.eye(4)
    pose[:3, 3] = (3.0, 0.0, 0.2)
    for device in ("kernels", "cpu"):
        assert [len(rows) for rows in solved(ur5e, pose[None], np.zeros(6), device)] == [0]


@pytest.mark.parametrize("device", ["kernels", "cpu"])
def test_the_same_seed_gives_the_same_solutions(ur5e: RobotModel, device: Device) -> None:
    poses = ur5e.fk_tip(random_joints(ur5e, 5, np.random.default_rng(4)))
    for first, second in zip(*(solved(ur5e, poses, np.zeros(6), device, most=4) for _ in range(2)), strict=True):
        np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize("device", ["kernels", "cpu"])
def test_a_batch_ends_on_cancel(ur5e: RobotModel, device: Device) -> None:
    stop = Deadline(60.0)
    stop.cancel()
    poses = ur5e.fk_tip(random_joints(ur5e, 5, np.random.default_rng(5)))
    with pytest.raises(Cancelled):
        batch_ik(ur5e, poses, np.zeros(6), world=None, max_solutions=1, seed=0, device=device, deadline=stop)


@pytest.mark.skipif(batches._has_gpu(), reason="there is a GPU here")
def test_cuda_where_there_is_no_gpu_is_refused_with_the_remedy(ur5e: RobotModel) -> None:
    with pytest.raises(InvalidRequest, match="CUDA build of torch") as raised:
        solved(ur5e, np.eye(4)[None], np.zeros(6), "cuda")
    assert raised.value.problem.field == "device"
    with pytest.raises(InvalidRequest, match="CUDA build of torch"):
        batch_fk(ur5e, np.zeros((1, 6)), "cuda")


def test_a_device_without_torch_is_refused_and_auto_is_not(ur5e: RobotModel, monkeypatch: pytest.MonkeyPatch) -> None:
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "torch" else find(name))
    batches._has_gpu.cache_clear()
    with pytest.raises(InvalidRequest, match=r"pip install 'zarm\[torch\]'") as raised:
        batch_fk(ur5e, np.zeros((1, 6)), "cpu")
    assert raised.value.problem.field == "device"
    poses = np.repeat(ur5e.fk_tip(np.full(6, 0.5))[None], WORTH_A_GPU // 64 + 1, axis=0)
    assert all(len(rows) == 64 for rows in solved(ur5e, poses, np.zeros(6), "auto", most=64))
    batches._has_gpu.cache_clear()


def test_solutions_in_exact_collision_are_replaced(tmp_path: Path) -> None:
    model, world = unchecked_pairs(tmp_path), World((), 0.0)
    poses, near = model.fk_tip([JOINTS]), np.array(model.robot.descriptor.home)
    scene = ExactScene(model, world)

    def found(exact: ExactScene | None) -> Array:
        deadline = Deadline(60.0)
        return batch_ik(
            model, poses, near, world=world, max_solutions=16, seed=0, device="kernels", deadline=deadline, exact=exact
        )[0]

    every, free = found(None), found(scene)
    assert not scene.is_free(every)
    assert scene.is_free(free)
    assert len(free) == len(every)
    np.testing.assert_allclose(model.fk_tip(free), np.broadcast_to(poses[0], (len(free), 4, 4)), rtol=0, atol=1e-6)


def test_ik_without_collision_answers_only_free_solutions(tmp_path: Path) -> None:
    model = unchecked_pairs(tmp_path)
    planner = Handlers(model, "arm", SceneStore(tmp_path / "state"), lambda: np.array(model.robot.descriptor.home))
    pose = pose_of(model.fk_tip(JOINTS))

    def collide(*, collision_free: bool) -> list[bool]:
        request = IkRequest(poses=(pose,), max_solutions=16, collision_free=collision_free)
        (found,) = planner.ik(request).solutions
        return [result.in_collision for result in planner.check(CheckRequest(joints=found)).results]

    assert any(collide(collision_free=False))
    assert not any(collide(collision_free=True))
    planner.close()
