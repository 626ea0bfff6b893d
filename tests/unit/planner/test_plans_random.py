"""Whatever the world, the robot and its load: a motion that the planner returns hits nothing and breaks no limit.

Held against the second opinion, which shares no code with the planner, ten times as densely as the motion is sampled.
"""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from support.jerk import greatest_jerk
from support.planner.second_opinion import Collisions
from support.planner.small_arm import small_arm
from support.planner.sphere_model import random_object, random_objects
from support.tiers import sampled
from zarm_contract.errors import DeadlineExceeded, PlanningFailed
from zarm_contract.messages import Attached, JointGoal, Trajectory
from zarm_contract.robot import RobotDescription, load_robot
from zarm_executor.checks import executable
from zarm_geometry.exact import ExactScene
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.context import PlanningContext
from zarm_planner.deadline import Deadline
from zarm_planner.pipeline import plan
from zarm_planner.planners.free import FreePlanner
from zarm_planner.scene.planning_scene import PlanningScene
from zarm_trajectory.limits import Limits

DENSER = 10
"""Moments that are looked at per sample of a motion."""
IGNORED = {"small_arm": ("cover",), "panda": ("panda_hand", "panda_leftfinger"), "doosan_m1013": ("link_5",)}
PROBLEMS = 3


def load(rng: np.random.Generator) -> Attached:
    kind = ("cuboid", "sphere", "capsule", "cylinder")[rng.integers(4)]
    return Attached(object=random_object(kind, "load", np.array([0.0, 0.0, 0.15]), 0.25, rng))


def free_near_home(robot: RobotDescription, collisions: Collisions, rng: np.random.Generator) -> list[np.ndarray]:
    """A start and a goal (dof,), at most 1.5 rad from home in each joint."""
    home = np.array(robot.descriptor.home)
    lower, upper = np.maximum(robot.lower, home - 1.5), np.minimum(robot.upper, home + 1.5)
    return list(islice((q for q in rng.uniform(lower, upper, (100, len(home))) if not collisions.at(q)), 2))


def assert_limits_held(trajectory: Trajectory, robot: RobotDescription) -> None:
    """By finite differences of positions, but for jerk."""
    path, limits = executable(trajectory, robot), robot.descriptor.cspace
    h = np.diff(trajectory.time).min() / DENSER
    position = np.array([path.at(t)[0] for t in np.arange(0.0, path.duration, h)])
    velocity, acceleration = np.diff(position, axis=0) / h, np.diff(position, 2, axis=0) / h**2
    assert np.all(np.abs(velocity) <= 1.002 * np.array(limits.velocity))
    assert np.all(np.abs(acceleration) <= 1.002 * np.array(limits.acceleration))
    assert np.all(greatest_jerk(path) <= 1.01 * np.array(limits.jerk))
    assert np.all(position >= np.array(robot.lower) - 2e-4)
    assert np.all(position <= np.array(robot.upper) + 2e-4)


@pytest.mark.lengthy
@pytest.mark.parametrize("changed", sampled("bare", "carrying", "ignoring"))
@pytest.mark.parametrize("name", sampled(*IGNORED))
def test_every_motion_is_free_and_within_limits(name: str, changed: str, tmp_path: Path) -> None:
    robot = small_arm(tmp_path) if name == "small_arm" else load_robot(name)
    bare, planned = RobotModel.of(robot), 0
    for seed in range(PROBLEMS):
        rng = np.random.default_rng(seed)
        attached = (load(rng),) if changed == "carrying" else ()
        ignored = IGNORED[name] if changed == "ignoring" else ()
        objects = [
            item
            for item in random_objects(16, 0.25, rng, 0.9)
            if not Collisions(robot, (item,), attached).at(robot.descriptor.home)
        ]
        collisions = Collisions(robot, objects, attached, ignored)
        start, goal = free_near_home(robot, collisions, rng)
        model = bare.with_attached(attached, ignored)
        world = World(objects, 0.005)
        snapshot = PlanningScene("1-000000000000", model, world, ExactScene(model, world))
        context = PlanningContext(snapshot, Limits.of(model.robot), Deadline(3.0), seed=seed)
        wanted = JointGoal(kind="joints", position=tuple(goal.tolist()))
        try:
            found = plan(FreePlanner(), context, start, wanted)
        except (PlanningFailed, DeadlineExceeded):
            continue  # not every pair has a way between
        planned += 1
        trajectory = found.trajectory.message(robot.descriptor.joints)
        assert_limits_held(trajectory, robot)
        path = executable(trajectory, robot)
        moments = np.linspace(0.0, path.duration, DENSER * len(trajectory.time))
        hit = [t for t in moments if collisions.at(path.at(t)[0])]
        assert not hit, f"seed {seed}: hits at {hit[0]:.3f} s of {path.duration:.3f} s"
    assert planned
