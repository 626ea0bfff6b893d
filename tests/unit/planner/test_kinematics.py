"""What kinematics promises: the poses that the URDF says, and every way to reach a pose."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from support.planner.small_arm import small_arm
from support.planner.sphere_model import random_joints
from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import Cuboid, Sphere
from zarm_contract.robot import load_robot
from zarm_geometry.collision import is_free
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.deadline import Deadline
from zarm_planner.kinematics.ik import solve_ik
from zarm_trajectory.arrays import Array

ROBOTS = ("doosan_m1013", "panda", "ur5e", "ur10e")


@pytest.fixture(scope="module", params=(*ROBOTS, "small_arm"))
def model(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> RobotModel:
    if request.param == "small_arm":
        return RobotModel.of(small_arm(tmp_path_factory.mktemp("robot")))
    return RobotModel.of(load_robot(request.param))


@pytest.fixture(scope="module")
def ur5e() -> RobotModel:
    return RobotModel.of(load_robot("ur5e"))


@pytest.mark.lengthy
def test_fk_is_that_of_pytorch_kinematics(model: RobotModel) -> None:
    import pytorch_kinematics as pk  # loads torch, for seconds: not where this file is only collected
    import torch

    joints = random_joints(model, 200, np.random.default_rng(1))
    descriptor = model.robot.descriptor
    # pytorch-kinematics insists on attributes that the URDF specification asks for and that do not matter here.
    text = model.robot.urdf_path.read_text()
    urdf = re.sub(r'(<limit lower="[^"]*" upper="[^"]*")/>', r'\1 effort="1" velocity="1"/>', text)
    chain = pk.build_chain_from_urdf(urdf.encode()).to(dtype=torch.float64)
    fingers = model.robot.gripper_positions({})
    named = dict(zip(descriptor.joints, joints.T, strict=True)) | {
        name: np.full(len(joints), at) for name, at in fingers.items()
    }
    poses = chain.forward_kinematics(
        torch.tensor(np.column_stack([named[name] for name in chain.get_joint_parameter_names()]))
    )
    base = np.linalg.inv(poses[descriptor.base_link].get_matrix().numpy())
    expected = {name: base @ pose.get_matrix().numpy() for name, pose in poses.items()}
    np.testing.assert_allclose(model.fk_tip(joints), expected[descriptor.tip_link], atol=1e-6)
    for index, link in enumerate(model.links):
        np.testing.assert_allclose(model.link_transforms(joints)[:, index], expected[link], atol=1e-6)


def test_poses_have_the_shape_of_what_was_asked(ur5e: RobotModel) -> None:
    assert ur5e.fk_tip(np.zeros(6)).shape == (4, 4)
    assert ur5e.fk_tip(np.zeros((2, 3, 6))).shape == (2, 3, 4, 4)
    assert ur5e.link_transforms(np.zeros((5, 6))).shape == (5, len(ur5e.links), 4, 4)


def test_a_joint_vector_of_the_wrong_length_is_refused(ur5e: RobotModel) -> None:
    with pytest.raises(InvalidRequest, match="6 values"):
        ur5e.fk_tip(np.zeros(7))


def test_links_meet_unless_ignored_or_on_one_body(tmp_path: Path) -> None:
    arm = RobotModel.of(small_arm(tmp_path))
    meeting = {frozenset((arm.links[a], arm.links[b])) for a, b in arm.pairs}
    assert meeting == {
        frozenset(pair)
        for pair in (
            ("stand", "upper"),
            ("stand", "fore"),
            ("stand", "cover"),
            ("stand", "rod"),
            ("turret", "fore"),
            ("turret", "cover"),
            ("turret", "rod"),
            ("upper", "cover"),
            ("upper", "rod"),
        )
    }


def test_no_sphere_moves_further_than_the_model_says(model: RobotModel) -> None:
    rng = np.random.default_rng(2)
    before = random_joints(model, 500, rng)
    step = rng.normal(size=before.shape) * 0.2
    balls = model.robot.descriptor.spheres
    for link, name in enumerate(model.links):
        centers = np.array([[*ball.center, 1.0] for ball in balls[name]]).T
        moved = (model.link_transforms(before + step)[:, link] - model.link_transforms(before)[:, link]) @ centers
        farthest = np.linalg.norm(moved[:, :3], axis=1).max(axis=1)
        assert np.all(farthest <= np.abs(step) @ model.arrays.reach[:, link] + 1e-6)


def reached(model: RobotModel, q: Array, pose: Array) -> bool:
    """Whether the tip at `q` is at the pose, to 1e-6 m and 1e-6 rad (and rounding)."""
    there = model.fk_tip(q)
    turn = there[:3, :3] @ pose[:3, :3].T
    sine = np.linalg.norm([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
    angle = math.atan2(sine, (np.trace(turn) - 1) / 2)
    return bool(np.linalg.norm(there[:3, 3] - pose[:3, 3]) < 1.01e-6 and angle < 1.01e-6)


@pytest.mark.lengthy
@pytest.mark.parametrize("name", ROBOTS)
def test_300_reachable_poses_are_solved_within_limits(name: str) -> None:
    model, rng = RobotModel.of(load_robot(name)), np.random.default_rng(3)
    for seed, (target, near) in enumerate(
        zip(random_joints(model, 300, rng), random_joints(model, 300, rng), strict=True)
    ):
        pose = model.fk_tip(target)
        result = solve_ik(model, pose, near, world=None, max_solutions=1, seed=seed, deadline=Deadline(10.0))
        for q in result.solutions:
            assert reached(model, q, pose)
            assert np.all((q >= model.lower) & (q <= model.upper))
        assert len(result.solutions) == 1


@pytest.mark.parametrize("name", ROBOTS)
def test_solutions_are_distinct_and_the_nearest_comes_first(name: str) -> None:
    model, rng = RobotModel.of(load_robot(name)), np.random.default_rng(4)
    for target, near in zip(random_joints(model, 20, rng), random_joints(model, 20, rng), strict=True):
        found = solve_ik(
            model, model.fk_tip(target), near, world=None, max_solutions=16, seed=0, deadline=Deadline(10.0)
        ).solutions
        assert len(found) > 1
        assert np.all(np.diff(np.linalg.norm(found - near, axis=1)) >= 0.0)
        apart = np.abs(found[:, None] - found[None]).max(axis=2) + np.eye(len(found))
        assert apart.min() > 0.09


def test_a_ur_has_eight_solutions_and_their_full_turns(ur5e: RobotModel) -> None:
    home = np.array(ur5e.robot.descriptor.home)
    pose = ur5e.fk_tip(home + 0.3)
    found = solve_ik(ur5e, pose, home, world=None, max_solutions=1000, seed=0, deadline=Deadline(10.0)).solutions
    ways = {tuple(np.round(np.mod(q + 1e-3, 2 * math.pi), 2)) for q in found}
    assert len(ways) == 8
    for q in found:
        for joint in range(6):
            for turn in (-2 * math.pi, 2 * math.pi):
                turned = q.copy()
                turned[joint] += turn
                if ur5e.lower[joint] <= turned[joint] <= ur5e.upper[joint]:
                    assert np.any(np.all(np.abs(found - turned) < 1e-3, axis=1))


def test_the_solution_near_the_start_is_found_first(ur5e: RobotModel) -> None:
    home = np.array(ur5e.robot.descriptor.home)
    result = solve_ik(
        ur5e, ur5e.fk_tip(home + 0.05), home, world=None, max_solutions=1, seed=0, deadline=Deadline(10.0)
    )
    np.testing.assert_allclose(result.solutions[0], home + 0.05, atol=1e-3)


def test_a_tip_turned_by_half_a_turn_is_solved(ur5e: RobotModel) -> None:
    home = np.array(ur5e.robot.descriptor.home)
    pose = ur5e.fk_tip(home)
    pose[:3, :3] = pose[:3, :3] @ np.diag([-1.0, -1.0, 1.0])
    result = solve_ik(ur5e, pose, home, world=None, max_solutions=1, seed=0, deadline=Deadline(10.0))
    assert reached(ur5e, result.solutions[0], pose)


def test_solutions_in_a_world_are_free_and_the_others_are_told(ur5e: RobotModel) -> None:
    home = np.array(ur5e.robot.descriptor.home)
    pose = ur5e.fk_tip(home + 0.3)
    elbow = ur5e.link_transforms(home + 0.3)[ur5e.links.index("forearm_link"), :3, 3]
    x, y, z = elbow.tolist()
    world = World((Sphere(kind="sphere", name="ball", position=(x, y, z), radius=0.05),), 0.0)
    result = solve_ik(ur5e, pose, home, world=world, max_solutions=16, seed=0, deadline=Deadline(10.0))
    assert len(result.solutions) > 0
    assert all(is_free(ur5e, world, q) for q in result.solutions)
    assert len(result.colliding) > 0
    assert not any(is_free(ur5e, world, q) for q in result.colliding)
    assert all(reached(ur5e, q, pose) for q in result.colliding)


def test_a_pose_inside_an_object_has_only_colliding_solutions(ur5e: RobotModel) -> None:
    home = np.array(ur5e.robot.descriptor.home)
    pose = ur5e.fk_tip(home)
    x, y, z = pose[:3, 3].tolist()
    world = World((Cuboid(kind="cuboid", name="block", position=(x, y, z), size=(0.2, 0.2, 0.2)),), 0.0)
    result = solve_ik(ur5e, pose, home, world=world, max_solutions=4, seed=0, deadline=Deadline(10.0))
    assert len(result.solutions) == 0
    assert len(result.colliding) > 0


def test_an_unreachable_pose_says_how_near_the_arm_comes(ur5e: RobotModel) -> None:
    pose = np.eye(4)
    pose[:3, 3] = (3.0, 0.0, 0.2)
    home = np.array(ur5e.robot.descriptor.home)
    result = solve_ik(ur5e, pose, home, world=None, max_solutions=1, seed=0, deadline=Deadline(10.0))
    assert len(result.solutions) == 0
    assert 1.8 < result.distance < 2.5


def test_the_same_seed_gives_the_same_solutions(model: RobotModel) -> None:
    target, near = random_joints(model, 2, np.random.default_rng(5))
    first, second = (
        solve_ik(
            model, model.fk_tip(target), near, world=None, max_solutions=4, seed=7, deadline=Deadline(10.0)
        ).solutions
        for _ in range(2)
    )
    np.testing.assert_array_equal(first, second)


def test_nothing_is_solved_after_a_cancel(ur5e: RobotModel) -> None:
    home = np.array(ur5e.robot.descriptor.home)
    stop = Deadline(10.0)
    stop.cancel()
    assert (
        len(solve_ik(ur5e, ur5e.fk_tip(home), home, world=None, max_solutions=1, seed=0, deadline=stop).solutions) == 0
    )


@pytest.mark.parametrize("degrees", [30.0, 90.0, 150.0, 180.0])
def test_how_near_a_pose_comes_is_an_angle(tmp_path: Path, degrees: float) -> None:
    """A flat arm cannot tilt its tip."""
    (tmp_path / "flat.urdf").write_text(FLAT_URDF)
    (tmp_path / "flat.yaml").write_text(FLAT)
    flat = RobotModel.of(load_robot(str(tmp_path / "flat.yaml")))
    q = np.array([0.5, 1.0])
    pose = flat.fk_tip(q)
    pose[:3, :3] = pose[:3, :3] @ Rotation.from_euler("x", degrees, degrees=True).as_matrix()
    found = solve_ik(flat, pose, q, world=None, max_solutions=4, seed=0, deadline=Deadline(60.0))
    assert len(found.solutions) == 0
    assert np.rad2deg(found.angle) == pytest.approx(degrees, abs=0.5)
    assert found.distance < 0.01


FLAT_URDF = """<robot name="flat"><link name="base"/><link name="upper"/><link name="fore"/>
<joint name="a" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/><limit lower="-3" upper="3"/></joint>
<joint name="b" type="revolute"><parent link="upper"/><child link="fore"/><origin xyz="0.3 0 0"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3"/></joint></robot>"""
FLAT = """
name: flat
urdf: flat.urdf
base_link: base
tip_link: fore
joints: [a, b]
home: [0.5, 1.0]
cspace: {velocity: [1, 1], acceleration: [2, 2], jerk: [50, 50]}
self_collision_ignore: [[base, upper], [upper, fore], [base, fore]]
collision: {base: [{kind: sphere, center: [0, 0, 0], radius: 0.02}], upper: [{kind: sphere, center: [0.15, 0, 0], radius: 0.02}], fore: [{kind: sphere, center: [0, 0, 0], radius: 0.02}]}
spheres: {base: [{center: [0, 0, 0], radius: 0.03}], upper: [{center: [0.15, 0, 0], radius: 0.03}], fore: [{center: [0, 0, 0], radius: 0.03}]}
"""
