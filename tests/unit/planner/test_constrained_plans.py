"""Plans that hold axes of the tip: to a pose, to joints, and through waypoints; verified on the timed motion."""

from __future__ import annotations

import numpy as np
import pytest

from support.planner import second_opinion
from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import (
    Cuboid,
    Cylinder,
    Goal,
    JointGoal,
    PathConstraint,
    PoseGoal,
    SceneObject,
    WaypointsGoal,
)
from zarm_contract.robot import load_robot
from zarm_geometry.collision import is_free
from zarm_geometry.exact import ExactScene
from zarm_geometry.frames import pose_of
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.constraints.path_constraint import ConstraintManifold, constrains
from zarm_planner.context import PlanningContext
from zarm_planner.deadline import Deadline
from zarm_planner.pipeline import Verified, plan
from zarm_planner.planners.registry import choose
from zarm_planner.scene.planning_scene import PlanningScene
from zarm_planner.timing.time_parameterization import time_path
from zarm_planner.verification.verify import VerificationFailed, verify
from zarm_trajectory.limits import Limits

HOME = np.array([0.0, -1.5, 1.5, -1.5, -1.5, 0.0])
UPRIGHT = PathConstraint(axes=(True, True, False, False, False, False), position_tolerance=0.003, angle_tolerance=0.01)
LEVEL = PathConstraint(axes=(True, True, True, False, False, True), position_tolerance=0.003, angle_tolerance=0.01)
DENSE = 0.002


@pytest.fixture(scope="module")
def model() -> RobotModel:
    return RobotModel.of(load_robot("ur5e"))


def moved(model: RobotModel, x: float, y: float, z: float) -> PoseGoal:
    """The pose at HOME, shifted in the base frame."""
    pose = pose_of(model.fk_tip(HOME))
    position = (pose.position[0] + x, pose.position[1] + y, pose.position[2] + z)
    return PoseGoal(kind="pose", position=position, orientation=pose.orientation)


def held_plan(
    model: RobotModel, goal: Goal, held: PathConstraint, *objects: SceneObject, optimize_s: float = 0.0
) -> Verified:
    world = World(objects, 0.005)
    snapshot = PlanningScene("1-000000000000", model, world, ExactScene(model, world))
    limits, deadline = Limits.of(model.robot), Deadline(60.0)
    context = PlanningContext(snapshot, limits, deadline, path_constraint=held, max_attempts=10, optimize_s=optimize_s)
    return plan(choose("auto", goal, constrains(held)), context, HOME, goal)


def tips(model: RobotModel, found: Verified) -> np.ndarray:
    """The tip's poses (n, 4, 4) along a motion, by forward kinematics that are not the planner's."""
    times = np.arange(0.0, found.trajectory.duration, DENSE)
    tip = model.robot.descriptor.tip_link
    return np.array([second_opinion.link_pose(model.robot, tip, q) for q in found.trajectory.sample(times)[0]])


def tilt(poses: np.ndarray) -> float:
    """The largest angle (rad) between the base's z axis at the start, seen from the tip, and later."""
    up = poses[:, 2, :3]
    return float(np.arccos(np.clip(up @ up[0], -1.0, 1.0)).max())


@pytest.mark.lengthy
def test_a_tool_stays_upright_all_the_way(model: RobotModel) -> None:
    found = held_plan(model, moved(model, -0.3, 0.3, 0.2), UPRIGHT)
    assert tilt(tips(model, found)) <= UPRIGHT.angle_tolerance * np.sqrt(2.0)


def test_samples_are_dense_enough_for_the_curve(model: RobotModel) -> None:
    assert model.robot.descriptor.interpolation_dt > 0.01
    found = held_plan(model, moved(model, 0.0, 0.2, 0.0), UPRIGHT)
    assert np.diff(found.trajectory.time).max() <= 0.01 + 1e-9


@pytest.mark.lengthy
def test_what_is_held_is_kept_around_an_obstacle(model: RobotModel) -> None:
    goal = moved(model, -0.25, 0.35, 0.0)
    x, y, z = (np.array(moved(model, 0.0, 0.0, 0.0).position) + goal.position) / 2
    post = Cylinder(kind="cylinder", name="post", position=(float(x), float(y), float(z)), radius=0.03, length=0.3)
    found = held_plan(model, goal, LEVEL, post)
    poses = tips(model, found)
    assert np.abs(poses[:, 2, 3] - poses[0, 2, 3]).max() <= LEVEL.position_tolerance
    assert tilt(poses) <= LEVEL.angle_tolerance * np.sqrt(2.0)
    collisions = second_opinion.Collisions(model.robot, [post])
    times = np.arange(0.0, found.trajectory.duration, DENSE)
    assert not any(collisions.at(q) for q in found.trajectory.sample(times)[0])


@pytest.mark.lengthy
def test_all_axes_but_one_make_a_straight_line(model: RobotModel) -> None:
    line = PathConstraint(axes=(True, True, True, False, True, True), position_tolerance=0.002, angle_tolerance=0.01)
    poses = tips(model, held_plan(model, moved(model, 0.2, 0.0, 0.0), line))
    assert np.abs(poses[:, 1:3, 3] - poses[0, 1:3, 3]).max() <= line.position_tolerance
    assert poses[-1, 0, 3] - poses[0, 0, 3] == pytest.approx(0.2, abs=1e-3)


@pytest.mark.lengthy
def test_waypoints_are_passed_without_a_stop_with_axes_held(model: RobotModel) -> None:
    through = (moved(model, 0.0, 0.2, 0.0), moved(model, -0.15, 0.3, 0.0), moved(model, -0.2, 0.1, 0.0))
    found = held_plan(model, WaypointsGoal(kind="waypoints", through=through), LEVEL)
    poses = tips(model, found)
    assert np.abs(poses[:, 2, 3] - poses[0, 2, 3]).max() <= LEVEL.position_tolerance
    assert len(found.waypoint_times) == 3
    for goal, time in zip(through, found.waypoint_times, strict=True):
        q, qd, _ = found.trajectory.sample(np.array([time]))
        distance, _ = second_opinion.tip_error(model.robot, q[0], goal.position, goal.orientation)
        assert distance <= 0.005
        assert goal is through[-1] or np.abs(qd).max() > 0.01


@pytest.mark.lengthy
def test_a_budget_makes_no_held_motion_slower_and_loses_nothing(model: RobotModel) -> None:
    goal = moved(model, -0.3, 0.3, 0.2)
    quick, better = (held_plan(model, goal, UPRIGHT, optimize_s=seconds) for seconds in (0.0, 0.3))
    assert better.trajectory.duration <= quick.trajectory.duration
    assert tilt(tips(model, better)) <= UPRIGHT.angle_tolerance * np.sqrt(2.0)


def test_a_goal_off_the_constraint_is_refused_with_the_axis(model: RobotModel) -> None:
    with pytest.raises(InvalidRequest, match=r"\bz would be off by 100\.00 mm") as refused:
        held_plan(model, moved(model, 0.0, 0.1, 0.1), LEVEL)
    assert refused.value.problem.field == "goal"
    turned = JointGoal(kind="joints", position=tuple((HOME + (0, 0, 0, 0.3, 0, 0)).tolist()))
    with pytest.raises(InvalidRequest, match="theta_"):
        held_plan(model, turned, UPRIGHT)


def test_no_axis_held_is_a_plan_like_any_other(model: RobotModel) -> None:
    nothing = PathConstraint(axes=(False,) * 6)
    free, held = (held_plan(model, moved(model, 0.0, 0.2, 0.1), axes) for axes in (nothing, UPRIGHT))
    assert free.trajectory.duration <= held.trajectory.duration


@pytest.mark.lengthy
def test_an_axis_is_held_from_a_start_and_to_a_goal_near_a_table(model: RobotModel) -> None:
    tip = model.fk_tip(HOME)[:3, 3]
    table = Cuboid(
        kind="cuboid", name="table", position=(float(tip[0]), 0.0, float(tip[2]) - 0.067), size=(0.6, 1.4, 0.1)
    )
    goal = moved(model, 0.0, 0.15, 0.0)
    assert not is_free(model, World((table,), 0.005), HOME)
    found = held_plan(model, goal, UPRIGHT, table)
    assert tilt(tips(model, found)) <= UPRIGHT.angle_tolerance * np.sqrt(2.0)
    assert 0.0 < found.clearance < 0.005


def test_verification_refuses_a_motion_that_loses_what_is_held(model: RobotModel) -> None:
    away = HOME + (0.0, 0.2, 0.0, 0.0, 0.0, 0.0)
    limits, exact = Limits.of(model.robot), ExactScene(model, World((), 0.0))
    motion = time_path(np.array((HOME, away)), limits, 0.01, 0.0)
    held = ConstraintManifold.of(model, UPRIGHT, HOME)
    assert verify(motion, HOME, away, limits, exact, lambda: None) > 0.0
    with pytest.raises(VerificationFailed, match="theta_"):
        verify(motion, HOME, away, limits, exact, lambda: None, held)
