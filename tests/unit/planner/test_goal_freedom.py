"""Goals with freedom: any pose within a tolerance is a goal, and the plan leads to one that is reached soon."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest

from support.planner.second_opinion import link_pose
from zarm_contract.errors import InvalidRequest, PlanningFailed
from zarm_contract.messages import (
    Attached,
    Cuboid,
    PathConstraint,
    Pose,
    PoseGoal,
    PoseTolerance,
    SceneObject,
    TipFrame,
    WaypointsGoal,
)
from zarm_contract.robot import load_robot
from zarm_geometry.exact import ExactScene
from zarm_geometry.frames import matrix, pose_of
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.context import PlanningContext
from zarm_planner.deadline import Deadline
from zarm_planner.pipeline import Verified, plan
from zarm_planner.planners.registry import choose
from zarm_planner.scene.planning_scene import PlanningScene
from zarm_trajectory.arrays import Array
from zarm_trajectory.limits import Limits

M1013 = RobotModel.of(load_robot("doosan_m1013"))
PANDA = RobotModel.of(load_robot("panda"))
HOME = np.array(M1013.robot.descriptor.home)
FREE = "free"
ANY_TURN = PoseTolerance(orientation=(FREE, FREE, FREE))
ROUNDING = 1e-5
"""m and rad: the end of a trajectory is rounded, and meets a goal's configuration to 1e-6 rad."""


def planned(
    model: RobotModel, goal: PoseGoal | WaypointsGoal, *objects: SceneObject, held: PathConstraint | None = None
) -> Verified:
    world = World(objects, 0.005)
    scene = PlanningScene("1-000000000000", model, world, ExactScene(model, world))
    context = PlanningContext(scene, Limits.of(model.robot), Deadline(60.0), held, optimize_s=0.0)
    return plan(choose("auto", goal, held is not None), context, np.array(model.robot.descriptor.home), goal)


def goal_at(pose: Array, tolerance: PoseTolerance | None, tip: TipFrame | None = None) -> PoseGoal:
    at = pose_of(pose)
    return PoseGoal(kind="pose", position=at.position, orientation=at.orientation, tolerance=tolerance, tip=tip)


def end_of(verified: Verified) -> Array:
    return verified.trajectory.position[-1]


def rotation_vector(a: Array, b: Array) -> Array:
    """The rotation from `a` to `b` (3, 3) as seen from `a`, by the matrix logarithm."""
    turn = a.T @ b
    angle = math.acos(min(1.0, max(-1.0, (np.trace(turn) - 1.0) / 2.0)))
    axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    return axis * (0.5 if angle < 1e-9 else angle / (2.0 * math.sin(angle)))


def reachable(model: RobotModel, count: int, seed: int = 3) -> Iterator[Array]:
    """Poses (4, 4) of the tip in random configurations that are free."""
    scene, random = ExactScene(model, World((), 0.0)), np.random.default_rng(seed)
    while count:
        q = random.uniform(*model.range_about(np.zeros(model.dof)))
        if scene.is_free(q):
            count -= 1
            yield model.fk_tip(q)


@pytest.mark.parametrize("model", [M1013, PANDA], ids=["doosan_m1013", "panda"])
@pytest.mark.parametrize(
    "tolerance",
    [
        ANY_TURN,
        PoseTolerance(orientation=(0.0, 0.0, FREE)),
        PoseTolerance(orientation=(FREE, 0.0, 0.0)),
        PoseTolerance(orientation=(0.1, 0.05, FREE), position=(0.01, 0.0, 0.03)),
        PoseTolerance(orientation=(0.0, 0.0, 0.2), position=(0.02, FREE, 0.0), frame="base"),
        PoseTolerance(orientation=(FREE, FREE, FREE), radius=0.03),
    ],
    ids=["position", "about_z", "about_x", "tool_box", "base_box", "ball"],
)
def test_plan_ends_within_the_tolerance(model: RobotModel, tolerance: PoseTolerance) -> None:
    for pose in reachable(model, 12):
        verified = planned(model, goal_at(pose, tolerance))
        tip = link_pose(model.robot, model.robot.descriptor.tip_link, end_of(verified))
        off = tip[:3, 3] - pose[:3, 3]
        turned = rotation_vector(pose[:3, :3], tip[:3, :3])
        shifted = pose[:3, :3].T @ off if tolerance.frame == "tool" else off
        for value, bound in zip((*turned, *shifted), tolerance.bounds, strict=False):
            assert abs(value) <= bound + ROUNDING
        assert np.linalg.norm(off) <= tolerance.bounds[6] + ROUNDING
        assert verified.deviation == pytest.approx((*turned, *shifted), abs=1e-4)


def test_freedom_makes_motions_shorter() -> None:
    exact, free = [], []
    for pose in reachable(M1013, 40):
        exact.append(planned(M1013, goal_at(pose, None)).trajectory.duration)
        free.append(planned(M1013, goal_at(pose, ANY_TURN)).trajectory.duration)
    assert np.median(np.array(free) / exact) < 0.95
    assert np.mean(np.array(free) <= 1.05 * np.array(exact)) > 0.9


def test_goal_near_the_start_is_reached_with_the_least_motion() -> None:
    pose = M1013.fk_tip(HOME)
    pose[:3, 3] += (0.0, 0.02, 0.0)
    verified = planned(M1013, goal_at(pose, PoseTolerance(orientation=(FREE, FREE, FREE), radius=0.021)))
    assert np.abs(end_of(verified) - HOME).max() < 0.01


def test_freedom_is_used_to_avoid_an_obstacle() -> None:
    pose = M1013.fk_tip(HOME)
    pose[:3, 3] += (0.0, 0.25, 0.0)
    inside = Cuboid(kind="cuboid", name="shelf", position=tuple(pose[:3, 3].tolist()), size=(0.1, 0.1, 0.1))
    with pytest.raises(PlanningFailed, match="inside shelf"):
        planned(M1013, goal_at(pose, ANY_TURN), inside)
    verified = planned(M1013, goal_at(pose, PoseTolerance(orientation=(FREE, FREE, FREE), radius=0.4)), inside)
    assert verified.clearance > 0.004


@pytest.mark.parametrize("link", ["link_3", "link_6"])
def test_any_link_may_be_brought_to_a_pose(link: str) -> None:
    random = np.random.default_rng(5)
    offset = Pose(position=(0.05, -0.02, 0.1), orientation=(0.0, 0.6, 0.0, 0.8))
    for _ in range(5):
        q = np.clip(HOME + random.uniform(-0.6, 0.6, 6), M1013.lower, M1013.upper)
        wanted = link_pose(M1013.robot, link, q) @ matrix(offset.position, offset.orientation)
        verified = planned(M1013, goal_at(wanted, None, TipFrame(link=link, offset=offset)))
        there = link_pose(M1013.robot, link, end_of(verified)) @ matrix(offset.position, offset.orientation)
        assert there == pytest.approx(wanted, abs=ROUNDING)


def test_attached_object_may_be_brought_to_a_pose() -> None:
    held = Cuboid(
        kind="cuboid", name="part", position=(0.0, 0.05, 0.15), orientation=(0.0, 0.6, 0.0, 0.8), size=(0.02,) * 3
    )
    model = M1013.with_attached((Attached(object=held),), ())
    away = HOME + (0.3, 0.1, -0.1, 0.2, 0.1, 0.4)
    grasp = matrix(held.position, held.orientation)
    wanted = model.fk_tip(away) @ grasp
    verified = planned(model, goal_at(wanted, None, TipFrame(link="part")))
    assert model.fk_tip(end_of(verified)) @ grasp == pytest.approx(wanted, abs=ROUNDING)


def test_frame_that_the_robot_lacks_is_refused_with_those_it_has() -> None:
    with pytest.raises(InvalidRequest, match=r"gripper is neither a link .* link_6") as refused:
        planned(M1013, goal_at(M1013.fk_tip(HOME), None, TipFrame(link="gripper")))
    assert refused.value.problem.field == "goal.tip.link"


def test_path_constraint_and_freedom_are_met_together() -> None:
    upright = PathConstraint(axes=(True, True, False, False, False, False))
    pose = M1013.fk_tip(HOME)
    pose[:3, 3] += (0.0, 0.3, -0.1)
    verified = planned(M1013, goal_at(pose, ANY_TURN), held=upright)
    tip = M1013.fk_tip(end_of(verified))
    assert tip[:3, 3] == pytest.approx(pose[:3, 3], abs=ROUNDING)
    assert tip[:3, 2] == pytest.approx(pose[:3, 2], abs=0.03)


def test_waypoints_may_have_freedom() -> None:
    pose = M1013.fk_tip(HOME)
    goals = []
    for shift in (0.1, 0.2):
        pose[1, 3] += shift
        goals.append(goal_at(pose, ANY_TURN))
    verified = planned(M1013, WaypointsGoal(kind="waypoints", through=tuple(goals)))
    assert M1013.fk_tip(end_of(verified))[:3, 3] == pytest.approx(pose[:3, 3], abs=ROUNDING)
    assert verified.deviation is not None


def test_unreachable_goal_names_the_component_in_the_way() -> None:
    pose = M1013.fk_tip(HOME)
    pose[:3, 3] *= 3.0
    with pytest.raises(PlanningFailed, match=r"at best, .* is off by .* mm") as failed:
        planned(M1013, goal_at(pose, PoseTolerance(orientation=(FREE, FREE, FREE))))
    assert failed.value.problem.code == "unreachable"


def test_pose_that_an_axis_keeps_from_being_reached_says_which() -> None:
    chain = RobotModel.of(load_robot("ur5e"))
    reach = chain.fk_tip(np.zeros(6))  # stretched out: the tip can only point along the arm
    turned = reach.copy()
    turned[:3, :3] = reach[:3, :3] @ matrix((0.0, 0.0, 0.0), (0.0, math.sin(0.2), 0.0, math.cos(0.2)))[:3, :3]
    with pytest.raises(PlanningFailed, match=r"it can be reached with .*theta_.* free"):
        planned(chain, goal_at(turned, PoseTolerance()))
