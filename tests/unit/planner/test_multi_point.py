"""One motion through several waypoints, in their order and without stopping."""

from __future__ import annotations

import numpy as np
import pytest

from support.planner import second_opinion
from zarm_contract.errors import PlanningFailed
from zarm_contract.messages import Cylinder, JointGoal, PoseGoal, SceneObject, Sphere, WaypointsGoal
from zarm_contract.robot import load_robot
from zarm_geometry.exact import ExactScene
from zarm_geometry.frames import pose_of
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.context import PlanningContext
from zarm_planner.deadline import Deadline
from zarm_planner.pipeline import Verified, plan
from zarm_planner.planners.free import FreePlanner
from zarm_planner.scene.planning_scene import PlanningScene
from zarm_planner.timing.time_parameterization import time_path
from zarm_planner.verification.verify import VerificationFailed
from zarm_planner.verification.waypoints import passing_times
from zarm_trajectory.limits import Limits

HOME = np.array([0.0, -1.5, 1.5, -1.5, -1.5, 0.0])
STOPS = [HOME + turn for turn in ([0.6, 0.1, 0, 0, 0, 0], [0.9, -0.2, 0.3, 0, 0, 0.4], [0.3, 0.2, -0.3, 0.2, 0, 0.4])]
DENSE = 0.002
EMPTY = World((), 0.005)


@pytest.fixture(scope="module")
def model() -> RobotModel:
    return RobotModel.of(load_robot("ur5e"))


def pose_goal(model: RobotModel, q: np.ndarray) -> PoseGoal:
    pose = pose_of(model.fk_tip(q))
    return PoseGoal(kind="pose", position=pose.position, orientation=pose.orientation)


def through(
    model: RobotModel,
    *goals: PoseGoal | JointGoal,
    objects: tuple[SceneObject, ...] = (),
    optimize_s: float = 0.0,
    seed: int = 0,
) -> Verified:
    world = World(objects, 0.005)
    snapshot = PlanningScene("1-000000000000", model, world, ExactScene(model, world))
    limits, deadline = Limits.of(model.robot), Deadline(60.0)
    context = PlanningContext(snapshot, limits, deadline, max_attempts=10, optimize_s=optimize_s, seed=seed)
    return plan(FreePlanner(), context, HOME, WaypointsGoal(kind="waypoints", through=goals))


def test_every_pose_is_passed_in_order_without_a_stop(model: RobotModel) -> None:
    goals = [pose_goal(model, q) for q in STOPS]
    found = through(model, *goals)
    assert len(found.waypoint_times) == 3
    assert list(found.waypoint_times) == sorted(found.waypoint_times)
    assert found.waypoint_times[-1] == pytest.approx(found.trajectory.duration, abs=DENSE)
    for goal, time in zip(goals, found.waypoint_times, strict=True):
        q, qd, _ = found.trajectory.sample(np.array([time]))
        distance, angle = second_opinion.tip_error(model.robot, q[0], goal.position, goal.orientation)
        assert distance <= 0.005
        assert angle <= 0.02
        if goal is not goals[-1]:
            assert np.abs(qd).max() > 0.05


def test_one_motion_beats_separate_plans_and_rounded_corners(
    model: RobotModel,
) -> None:
    goals = [JointGoal(kind="joints", position=tuple(q)) for q in STOPS]
    found = through(model, *goals)
    snapshot = PlanningScene("1-000000000000", model, EMPTY, ExactScene(model, EMPTY))
    context = PlanningContext(snapshot, Limits.of(model.robot), Deadline(60.0), max_attempts=10)
    alone = [
        plan(FreePlanner(), context, start, goal).trajectory.duration
        for start, goal in zip([HOME, *STOPS], goals, strict=False)
    ]
    assert found.trajectory.duration < sum(alone)
    rounded = time_path(np.array([HOME, *STOPS]), Limits.of(model.robot), 0.01, 0.03)
    assert found.trajectory.duration < 0.95 * rounded.duration


@pytest.mark.lengthy
def test_obstacles_between_waypoints_are_avoided(model: RobotModel) -> None:
    x, y, z = model.fk_tip((STOPS[0] + STOPS[1]) / 2)[:3, 3].tolist()
    post = Cylinder(kind="cylinder", name="post", position=(x, y, z - 0.1), radius=0.02, length=0.2)
    found = through(model, *(pose_goal(model, q) for q in STOPS), objects=(post,))
    collisions = second_opinion.Collisions(model.robot, [post])
    times = np.arange(0.0, found.trajectory.duration, DENSE)
    assert not any(collisions.at(q) for q in found.trajectory.sample(times)[0])
    assert len(found.waypoint_times) == 3


def test_a_waypoint_may_be_passed_twice(model: RobotModel) -> None:
    first, second = pose_goal(model, STOPS[0]), pose_goal(model, STOPS[1])
    found = through(model, first, second, first)
    assert len(found.waypoint_times) == 3
    assert list(found.waypoint_times) == sorted(set(found.waypoint_times))


def test_a_waypoint_that_cannot_be_reached_is_named(model: RobotModel) -> None:
    far = PoseGoal(kind="pose", position=(3.0, 0.0, 0.0))
    with pytest.raises(PlanningFailed) as refused:
        through(model, pose_goal(model, STOPS[0]), far)
    assert refused.value.code == "unreachable"
    assert refused.value.problem.field == "goal.through.1"


def test_a_waypoint_inside_an_obstacle_is_named(model: RobotModel) -> None:
    x, y, z = model.fk_tip(STOPS[1])[:3, 3].tolist()
    lump = Sphere(kind="sphere", name="lump", position=(x, y, z), radius=0.1)
    with pytest.raises(PlanningFailed) as refused:
        through(model, *(pose_goal(model, q) for q in STOPS), objects=(lump,))
    assert refused.value.code == "goal_in_collision"
    assert refused.value.problem.field == "goal.through.1"


@pytest.mark.lengthy
def test_a_budget_makes_motions_faster_and_never_slower(model: RobotModel) -> None:
    goals = [JointGoal(kind="joints", position=tuple(q)) for q in STOPS]
    pairs = [
        tuple(through(model, *goals, optimize_s=budget, seed=seed).trajectory.duration for budget in (0.0, 0.3))
        for seed in range(6)
    ]
    assert all(better <= quick for quick, better in pairs)
    assert any(better < quick for quick, better in pairs)


def test_missed_or_reordered_waypoints_are_refused(model: RobotModel) -> None:
    limits = Limits.of(model.robot)
    motion = time_path(np.array([HOME, *STOPS]), limits, 0.01, 0.0)
    first, second, last = passing_times(model, motion, STOPS, 0.005, 0.02)
    assert 0.0 < first < second < last
    with pytest.raises(VerificationFailed, match="waypoint 1"):
        passing_times(model, motion, [STOPS[0], STOPS[1] + 0.1, STOPS[2]], 0.005, 0.02)
    with pytest.raises(VerificationFailed, match="waypoint 1"):
        passing_times(model, motion, [STOPS[1], STOPS[0], STOPS[2]], 0.005, 0.02)
