"""The robots that come with zarm are the real ones: where they reach, how large they are, what they touch."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from support.paths import SHARED
from support.planner.containment import contains
from support.tiers import sampled
from zarm_contract.collision import CollisionCapsule, CollisionSphere
from zarm_contract.robot import ROBOTS, RobotDescription, load_robot
from zarm_contract.urdf import Urdf

NAMES = ("doosan_m1013", "panda", "ur10e", "ur5e")
ARMS = ("doosan_m1013", "ur10e", "ur5e")
FACTS = SHARED / "robots"
"""Measurements on the vendors' descriptions, where this checkout has them beside it."""

TIPS = {
    "doosan_m1013": (
        [3.914367, -5.701828, -2.191755, -5.249021, -1.744345, -6.276487],
        [0.092147345, 0.184544115, 0.588591845],
        [0.421300039, -0.789256357, -0.353650127, 0.272969352],
    ),
    "ur5e": (
        [3.228493, -5.40989, -2.527753, -6.251774, -4.058614, -3.07341],
        [-0.328062093, -0.101580699, 0.311748039],
        [0.609193271, -0.211758048, 0.242494126, 0.724733528],
    ),
    "ur10e": (
        [-2.910492, -3.418434, 2.398057, 2.204399, -1.253984, -2.500612],
        [0.479619463, -0.103351101, 0.557733654],
        [0.900156354, 0.025373348, 0.243590039, -0.360192484],
    ),
}
"""Joints (rad), position (m) and quaternion (w x y z) of the tip, by pinocchio on the vendors' own URDFs."""


def facts(name: str) -> Any:
    file = FACTS / f"{name}.json"
    if not file.is_file():
        pytest.skip(f"{file} is not here")
    return json.loads(file.read_text())


def poses(urdf: Urdf, joints: tuple[str, ...], q: np.ndarray) -> dict[str, np.ndarray]:
    """The pose (4, 4) of every link in the root of the tree."""
    values = dict(zip(joints, q, strict=True))
    (root,) = set(urdf.links) - set(urdf.joint_of_child)
    found = {root: np.eye(4)}
    while len(found) < len(urdf.links):
        for link, joint in urdf.joint_of_child.items():
            if joint.parent in found and link not in found:
                roll, pitch, yaw = (turn(axis, angle) for axis, angle in zip(np.eye(3), joint.rpy, strict=True))
                origin = yaw @ pitch @ roll
                origin[:3, 3] = joint.xyz
                at, axis = values.get(joint.name, 0.0), np.array(joint.axis)
                found[link] = (
                    found[joint.parent] @ origin @ (slide(axis, at) if joint.type == "prismatic" else turn(axis, at))
                )
    return found


def slide(axis: np.ndarray, distance: float) -> np.ndarray:
    """A translation (4, 4) along a unit axis."""
    pose = np.eye(4)
    pose[:3, 3] = distance * axis
    return pose


def turn(axis: np.ndarray, angle: float) -> np.ndarray:
    """A rotation (4, 4) about a unit axis, by Rodrigues' formula."""
    cross = np.cross(np.eye(3), axis)
    pose = np.eye(4)
    pose[:3, :3] += math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
    return pose


def pose_of(position: list[float], quaternion_wxyz: list[float]) -> np.ndarray:
    w, x, y, z = quaternion_wxyz
    angle = 2 * math.atan2(math.hypot(x, y, z), w)
    pose = turn(np.array([x, y, z]) / max(math.hypot(x, y, z), 1e-300), angle)
    pose[:3, 3] = position
    return pose


def same_pose(one: np.ndarray, other: np.ndarray) -> bool:
    """Within 1e-6 m and 1e-6 rad."""
    turned = one[:3, :3].T @ other[:3, :3]
    angle = np.linalg.norm([turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]]) / 2
    return bool(np.linalg.norm(one[:3, 3] - other[:3, 3]) < 1e-6 and angle < 1e-6 and np.trace(turned) > 2.9)


def random_joints(robot: RobotDescription, count: int) -> np.ndarray:
    return np.random.default_rng(7).uniform(robot.lower, robot.upper, (count, len(robot.lower)))


def touching(robot: RobotDescription, q: np.ndarray) -> set[frozenset[str]]:
    """The pairs of links whose spheres overlap, of those that are to be checked."""
    at = poses(robot.urdf, robot.descriptor.joints, q)
    ignored = {frozenset(pair) for pair in robot.descriptor.self_collision_ignore}
    balls = {
        link: (
            np.array([ball.center for ball in cover]) @ at[link][:3, :3].T + at[link][:3, 3],
            [b.radius for b in cover],
        )
        for link, cover in robot.descriptor.spheres.items()
    }
    return {
        frozenset((one, other))
        for one, (center, radius) in balls.items()
        for other, (centers, radii) in balls.items()
        if one < other
        and frozenset((one, other)) not in ignored
        and np.any(np.linalg.norm(center[:, None] - centers, axis=2) < np.add.outer(radius, radii))
    }


# -- the files --


def test_zarm_brings_these_robots_each_named_after_its_file() -> None:
    assert sorted(file.stem for file in ROBOTS.glob("*.yaml")) == sorted(NAMES)
    assert [load_robot(name).descriptor.name for name in NAMES] == list(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_the_urdf_says_where_its_facts_come_from(name: str) -> None:
    head = (ROBOTS / f"{name}.urdf").read_text().split("<robot")[0]
    assert "acts from" in head or "rames from" in head
    assert "BSD-3-Clause" in head or "Apache-2.0" in head


# -- kinematics --


@pytest.mark.parametrize("name", ARMS)
def test_the_tip_is_where_the_vendors_description_puts_it(name: str) -> None:
    robot = load_robot(name)
    q, position, quaternion = TIPS[name]
    tip = poses(robot.urdf, robot.descriptor.joints, np.array(q))[robot.descriptor.tip_link]
    assert same_pose(tip, pose_of(position, quaternion))


@pytest.mark.parametrize("name", ARMS)
def test_all_measured_poses_are_met(name: str) -> None:
    check, robot = facts(name)["fk_check"], load_robot(name)
    assert tuple(check["joint_names"]) == robot.descriptor.joints
    for vector in [*check["vectors"], check["zero_configuration"]]:
        tip = poses(robot.urdf, robot.descriptor.joints, np.array(vector["q"]))[robot.descriptor.tip_link]
        assert same_pose(tip, pose_of(vector["xyz"], vector["quat_wxyz"]))
    frames = poses(robot.urdf, robot.descriptor.joints, np.array(check["vectors"][0]["q"]))
    for link, frame in check["all_link_frames_of_vector_0"].items():
        assert same_pose(frames[link], pose_of(frame["xyz"], frame["quat_wxyz"])), link


@pytest.mark.slow  # loads torch; the planner's kinematics are held against the same reader
@pytest.mark.parametrize("name", NAMES)
def test_another_reader_of_the_urdf_sees_the_same_kinematics(name: str) -> None:
    import pytorch_kinematics
    import torch

    robot = load_robot(name)
    chain = pytorch_kinematics.build_chain_from_urdf(robot.urdf_path.read_bytes()).to(dtype=torch.float64)
    fingers = robot.gripper_positions(dict.fromkeys(robot.descriptor.grippers, 0.03))
    names = (*robot.descriptor.joints, *fingers)
    assert tuple(chain.get_joint_parameter_names()) == names
    configurations = [(*q, *fingers.values()) for q in random_joints(robot, 20)]
    theirs = chain.forward_kinematics(torch.tensor(configurations, dtype=torch.float64))
    for index, q in enumerate(configurations):
        for link, pose in poses(robot.urdf, names, q).items():
            assert same_pose(pose, theirs[link].get_matrix()[min(index, len(theirs[link]) - 1)].numpy()), link


@pytest.mark.parametrize("name", ARMS)
def test_joint_ranges_are_the_vendors(name: str) -> None:
    robot, measured = load_robot(name), facts(name)
    assert (robot.lower, robot.upper) == (tuple(measured["lower"]), tuple(measured["upper"]))


# -- speed --


@pytest.mark.parametrize("name", ARMS)
def test_the_arm_is_never_asked_for_more_than_it_can(name: str) -> None:
    robot, limits = load_robot(name), facts(name)["planning_defaults"]
    for kind in ("velocity", "acceleration", "jerk"):
        assert np.all(np.array(getattr(robot.descriptor.cspace, kind)) <= limits[kind]), kind


def test_the_doosan_stays_under_the_ceilings_of_its_driver() -> None:
    cspace = load_robot("doosan_m1013").descriptor.cspace
    assert max(cspace.velocity) < math.radians(70)
    assert max(cspace.acceleration) < math.radians(70)


# -- geometry --


@pytest.mark.parametrize("name", sampled("panda", "ur5e", "ur10e", "doosan_m1013"))
def test_the_spheres_contain_the_exact_geometry(name: str) -> None:
    descriptor = load_robot(name).descriptor
    for link, primitives in descriptor.collision.items():
        for primitive in primitives:
            assert contains(descriptor.spheres[link], primitive), (link, primitive)


@pytest.mark.parametrize("name", sampled("ur5e", "ur10e", "panda", "doosan_m1013"))
def test_no_sphere_may_be_2_mm_smaller(name: str) -> None:
    descriptor = load_robot(name).descriptor
    for link, spheres in descriptor.spheres.items():
        for index, sphere in enumerate(spheres):
            smaller = sphere.model_copy(update={"radius": sphere.radius - 0.002})
            cover = (*spheres[:index], smaller, *spheres[index + 1 :])
            assert not all(contains(cover, primitive) for primitive in descriptor.collision[link]), (link, sphere)


def measured_covers(name: str) -> Iterator[tuple[str, list[dict[str, Any]]]]:
    """Per link, shapes that were certified to contain the vendor's mesh."""
    links = facts(name)["collision"]["links"]
    for link, sets in links.items():
        if link == "base_link#cable":
            continue  # left out of the descriptor, with its reason there
        if name != "doosan_m1013":
            yield link, sets["spheres_visual"]["items"]
        else:
            kind = "capsules" if link in ("link_1", "link_3", "link_4", "link_5") else "spheres"
            yield link.removesuffix("#body"), sets[kind]["items"]


@pytest.mark.parametrize("name", ARMS)
def test_exact_geometry_contains_the_fitted_meshes(name: str) -> None:
    collision = load_robot(name).descriptor.collision
    for link, items in measured_covers(name):
        for item in items:
            kind = item.pop("type")
            shape = CollisionSphere(**item) if kind == "sphere" else CollisionCapsule(kind=kind, **item)
            assert contains(collision[link], shape), (link, item)


# -- self-collision --


@pytest.mark.parametrize("name", NAMES)
def test_home_is_free_and_clear_of_every_joint_stop(name: str) -> None:
    robot = load_robot(name)
    assert not touching(robot, np.array(robot.descriptor.home))
    home = np.array(robot.descriptor.home)
    assert np.all(home > np.array(robot.lower) + 0.1)
    assert np.all(home < np.array(robot.upper) - 0.1)


@pytest.mark.parametrize("name", NAMES)
def test_home_is_far_from_singular(name: str) -> None:
    robot = load_robot(name)
    joints, tip = robot.descriptor.joints, robot.descriptor.tip_link
    home, step = np.array(robot.descriptor.home), 1e-6
    before = poses(robot.urdf, joints, home)[tip]
    columns = []
    for nudge in step * np.eye(len(home)):
        change = poses(robot.urdf, joints, home + nudge)[tip] - before
        turned = change[:3, :3] @ before[:3, :3].T
        columns.append([*change[:3, 3], turned[2, 1], turned[0, 2], turned[1, 0]])
    assert np.linalg.svd(np.array(columns) / step, compute_uv=False)[-1] > 0.1


@pytest.mark.lengthy
@pytest.mark.parametrize("name", NAMES)
def test_most_configurations_are_free_of_self_collision(name: str) -> None:
    robot = load_robot(name)
    touched = [touching(robot, q) for q in random_joints(robot, 200)]
    assert sum(map(bool, touched)) < 0.4 * len(touched)


@pytest.mark.parametrize("name", ARMS)
def test_known_self_collisions_are_seen(name: str) -> None:
    robot = load_robot(name)
    ignored = {frozenset(pair) for pair in robot.descriptor.self_collision_ignore}
    for known in facts(name)["self_collision"]["known_self_colliding"]:
        collide = {frozenset(pair) for pair in known["robust_pairs"]} - ignored
        assert collide
        assert collide <= touching(robot, np.array(known["q"]))


@pytest.mark.parametrize("name", ARMS)
def test_configurations_known_to_be_free_are_free(name: str) -> None:
    robot, measured = load_robot(name), facts(name)
    free = [known["q"] for known in measured["self_collision"]["known_collision_free"]]
    free += [named["q"] for named in measured["named_configurations"].values() if isinstance(named, dict)]
    for q in free:
        assert not touching(robot, np.array(q)), q
