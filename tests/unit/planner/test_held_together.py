"""A path constraint on the pose between two tips: two arms hold one object, and the arm without a goal follows."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from support.composed import torso_with_arms, two_pandas
from support.examples import examples
from support.planner.second_opinion import link_pose
from zarm_contract.errors import InvalidRequest, PlanningFailed
from zarm_contract.messages import (
    Goal,
    GroupGoal,
    GroupsGoal,
    JointGoal,
    PathConstraint,
    Plan,
    PlanRequest,
    Pose,
    PoseGoal,
    PoseTolerance,
    WaypointsGoal,
)
from zarm_contract.robot import RobotDescription, load_robot
from zarm_geometry.exact import ExactScene
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.constraints.path_constraint import ConstraintManifold
from zarm_planner.handlers import Handlers
from zarm_planner.kernels.manifold import CLOSE
from zarm_planner.scene.store import SceneStore
from zarm_trajectory.arrays import Array
from zarm_trajectory.limits import Limits
from zarm_trajectory.trajectory import TimedTrajectory

DOWN = (1.0, 0.0, 0.0, 0.0)
TRAY = PathConstraint(axes=(True,) * 6, group="right", relative_to="left")
TIPS = {"left": "left_panda_grasptarget", "right": "right_panda_grasptarget"}


@cache
def described(name: str) -> RobotDescription:
    with tempfile.TemporaryDirectory() as folder:
        return load_robot(str({"pandas": two_pandas, "torso": torso_with_arms}[name](Path(folder))))


PANDAS = RobotModel.of(described("pandas"))
TORSO = RobotModel.of(described("torso"))


def pose(x: float, y: float, z: float, **fields: object) -> PoseGoal:
    return PoseGoal(kind="pose", position=(x, y, z), orientation=DOWN, **fields)  # type: ignore[arg-type]


def both(left: PoseGoal | JointGoal, right: PoseGoal | JointGoal) -> GroupsGoal:
    return GroupsGoal(kind="groups", goals=(GroupGoal(group="left", goal=left), GroupGoal(group="right", goal=right)))


@pytest.fixture(scope="module")
def pandas(tmp_path_factory: pytest.TempPathFactory) -> Handlers:
    home = np.array(PANDAS.robot.descriptor.home)
    return Handlers(PANDAS, "pandas", SceneStore(tmp_path_factory.mktemp("scene")), lambda: home)


@pytest.fixture(scope="module")
def start(pandas: Handlers) -> tuple[float, ...]:
    """Both hands 0.4 m apart, pointing down."""
    goal = both(pose(0.45, 0.2, 0.3), pose(0.45, -0.2, 0.3))
    return end_of(pandas.plan(PlanRequest(goal=goal, optimize_s=0.0)))


def request(goal: Goal, start: tuple[float, ...], constraint: PathConstraint = TRAY, **fields: object) -> PlanRequest:
    return PlanRequest(goal=goal, start=start, path_constraint=constraint, optimize_s=0.0, **fields)  # type: ignore[arg-type]


def end_of(plan: Plan) -> tuple[float, ...]:
    """The joints in which a plan ends."""
    return tuple(np.array(plan.trajectory.position[-1]).tolist())


def tip(name: str, q: Array) -> Array:
    """From the URDF, by other code than the planner's."""
    return link_pose(PANDAS.robot, TIPS[name], q)


def between(q: Array) -> Array:
    """The right tip as seen from the left one."""
    seen: Array = np.linalg.inv(tip("left", q)) @ tip("right", q)
    return seen


def kept(plan: Plan, tolerance: float = 1e-3) -> Array:
    """The end (dof,) of a plan that keeps the pose between the tips all along, touches nothing, and is within the limits."""
    trajectory = TimedTrajectory.of(plan.trajectory, PANDAS.robot.descriptor.joints)
    Limits.of(PANDAS.robot).check(trajectory)
    dense = trajectory.positions(np.linspace(0.0, trajectory.duration, 300))
    assert ExactScene(PANDAS, World((), 0.0)).nearest(dense).distance > 0.0
    first = between(dense[0])
    assert max(np.abs(between(q) - first).max() for q in dense) < tolerance
    return dense[-1]


@pytest.mark.parametrize("goal", [(0.55, 0.1, 0.45), (0.35, 0.3, 0.2), (0.4, 0.0, 0.6)])
def test_the_arm_without_a_goal_follows(
    pandas: Handlers, start: tuple[float, ...], goal: tuple[float, float, float]
) -> None:
    plan = pandas.plan(request(pose(*goal), start, group="left"))
    end = kept(plan)
    assert tip("left", end)[:3, 3] == pytest.approx(goal, abs=1e-4)
    assert tip("right", end)[:3, 3] == pytest.approx(np.subtract(goal, (0.0, 0.4, 0.0)), abs=1e-4)
    assert plan.tip.position == pytest.approx(goal, abs=1e-4)


def test_either_arm_follows_the_other(pandas: Handlers, start: tuple[float, ...]) -> None:
    left_follows = PathConstraint(axes=(True,) * 6, group="left", relative_to="right")
    end = kept(pandas.plan(request(pose(0.5, -0.3, 0.4), start, left_follows, group="right")))
    assert tip("left", end)[:3, 3] == pytest.approx((0.5, 0.1, 0.4), abs=1e-4)


def test_goals_with_freedom_are_followed_by_both_arms(pandas: Handlers, start: tuple[float, ...]) -> None:
    tilted = pose(0.5, 0.2, 0.4, tolerance=PoseTolerance(orientation=(0.2, 0.2, 0.2)))
    kept(pandas.plan(request(tilted, start, group="left")))
    out_of_reach = Pose(position=(2.0, 0.0, 0.4), orientation=DOWN)
    several = PoseGoal(
        kind="pose",
        position=out_of_reach.position,
        orientation=DOWN,
        alternatives=(Pose(position=(0.5, 0.2, 0.4), orientation=DOWN),),
    )
    plan = pandas.plan(request(several, start, group="left"))
    kept(plan)
    assert plan.selected_goal_index == 1


def test_joints_of_one_arm_are_followed_and_of_both_kept(pandas: Handlers, start: tuple[float, ...]) -> None:
    end = kept(pandas.plan(request(pose(0.5, 0.2, 0.45), start, group="left")))
    left, right = (JointGoal(kind="joints", position=tuple(end[part].tolist())) for part in (slice(7), slice(7, 14)))
    assert kept(pandas.plan(request(left, start, group="left")))[:7] == pytest.approx(end[:7], abs=1e-6)
    everything = JointGoal(kind="joints", position=tuple(end.tolist()))
    for goal in (both(left, right), everything):
        assert kept(pandas.plan(request(goal, start))) == pytest.approx(end, abs=1e-6)


def test_goals_that_would_tear_the_object_are_refused(pandas: Handlers, start: tuple[float, ...]) -> None:
    kept(pandas.plan(request(both(pose(0.5, 0.2, 0.4), pose(0.5, -0.2, 0.4)), start)))
    with pytest.raises(InvalidRequest, match="in the frame of the tip of left, y would be off by 20") as refused:
        pandas.plan(request(both(pose(0.5, 0.2, 0.4), pose(0.5, -0.22, 0.4)), start))
    assert refused.value.problem.field == "goal"


def test_where_only_the_arm_that_follows_cannot_be_is_said(pandas: Handlers, start: tuple[float, ...]) -> None:
    aside = pose(0.3, 0.95, 0.3)
    pandas.plan(PlanRequest(goal=aside, start=start, group="left", optimize_s=0.0))
    with pytest.raises(PlanningFailed, match=r"right cannot follow: .* cannot be reached") as refused:
        pandas.plan(request(aside, start, group="left"))
    assert refused.value.problem.field == "path_constraint.group"
    assert refused.value.problem.code == "unreachable"


def test_a_hand_that_may_turn_about_what_it_holds_keeps_the_rest(pandas: Handlers, start: tuple[float, ...]) -> None:
    """A pole between two hands: only the distance along it, here y of the left tip, is free."""
    constraint = TRAY.model_copy(update={"axes": (True, True, True, True, False, True)})
    wider = both(pose(0.5, 0.25, 0.4), pose(0.5, -0.25, 0.4))
    plan = pandas.plan(request(wider, start, constraint))
    trajectory = TimedTrajectory.of(plan.trajectory, PANDAS.robot.descriptor.joints)
    first = between(trajectory.position[0])
    off = np.array([np.abs(between(q) - first) for q in trajectory.position]).max(axis=0)
    assert off[1, 3] == pytest.approx(0.1, abs=1e-3)
    off[1, 3] = 0.0
    assert off.max() < 1e-3


def test_a_tip_is_held_in_the_frame_of_an_arm_that_stands(pandas: Handlers, start: tuple[float, ...]) -> None:
    """Across the direction in which the standing hand points, which is not along an axis of the base."""
    leaning = PoseGoal(kind="pose", position=(0.45, -0.3, 0.35), orientation=(0.9689124, 0.0, 0.2474040, 0.0))
    lean = end_of(pandas.plan(PlanRequest(goal=leaning, start=start, group="right", optimize_s=0.0)))
    in_plane = PathConstraint(axes=(False, False, False, False, False, True), relative_to="right")
    across = tip("right", np.array(lean))[:3, 2]
    assert 0.1 < abs(across[0]) < 0.9
    along = tip("left", np.array(lean))[:3, 3] + 0.2 * np.cross(across, (0.0, 1.0, 0.0))
    plan = pandas.plan(request(pose(*along.tolist()), lean, in_plane, group="left"))
    heights = [across @ tip("left", np.array(q))[:3, 3] for q in plan.trajectory.position]
    assert np.ptp(heights) < 1e-3
    with pytest.raises(InvalidRequest, match="in the frame of the tip of right, z would be off"):
        pandas.plan(request(pose(*(along + 0.05 * across).tolist()), lean, in_plane, group="left"))


@examples(0.5)
@given(st.integers(0, 2**32 - 1), st.sampled_from(["base", "tool"]))
def test_projection_keeps_the_pose_between_the_tips(seed: int, frame: str) -> None:
    rng = np.random.default_rng(seed)
    first, q = rng.uniform(PANDAS.lower, PANDAS.upper, (2, PANDAS.dof))
    held = ConstraintManifold.of(PANDAS, TRAY.model_copy(update={"frame": frame}), first)
    near = held.projected(q)
    if near is not None:
        assert np.abs(between(near[0]) - between(first)).max() < 2 * CLOSE
        assert np.all((near >= PANDAS.lower) & (near <= PANDAS.upper))


@examples(0.5)
@given(st.integers(0, 2**32 - 1))
def test_joints_that_carry_both_arms_move_neither_relatively(seed: int) -> None:
    rng = np.random.default_rng(seed)
    first = rng.uniform(*TORSO.range_about(np.zeros(TORSO.dof)))
    held = ConstraintManifold.of(TORSO, TRAY, first)
    torso = [TORSO.robot.descriptor.joints.index(joint) for joint in TORSO.robot.group_joints("torso")]
    moved = first.copy()
    moved[torso] = rng.uniform(*TORSO.range_about(np.zeros(TORSO.dof)))[torso]
    assert held.use([moved]).max() < 1e-6
    assert np.array_equal(held.projected(moved), moved[None])


@pytest.mark.parametrize(
    ("fields", "goal", "field", "says"),
    [
        ({"relative_to": "middle"}, pose(0.5, 0.2, 0.4), "path_constraint.relative_to", "no group middle"),
        ({"group": "middle"}, pose(0.5, 0.2, 0.4), "path_constraint.group", "no group middle"),
        ({"group": "left"}, pose(0.5, 0.2, 0.4), "path_constraint.relative_to", "that of another group"),
        (
            {},
            WaypointsGoal(kind="waypoints", through=(pose(0.5, 0.2, 0.4), pose(0.5, 0.2, 0.3))),
            "path_constraint.group",
            "one waypoint after the other",
        ),
    ],
)
def test_a_constraint_that_cannot_be_meant_is_refused(
    pandas: Handlers,
    start: tuple[float, ...],
    fields: dict[str, str],
    goal: PoseGoal | WaypointsGoal,
    field: str,
    says: str,
) -> None:
    with pytest.raises(InvalidRequest, match=says) as refused:
        pandas.plan(request(goal, start, TRAY.model_copy(update=fields), group="left"))
    assert refused.value.problem.field == field


def test_of_several_tips_the_constraint_names_one(pandas: Handlers, start: tuple[float, ...]) -> None:
    upright = PathConstraint(axes=(True, True, False, False, False, False))
    goal = both(pose(0.5, 0.2, 0.4), pose(0.5, -0.25, 0.45))
    with pytest.raises(InvalidRequest, match="several tips") as refused:
        pandas.plan(request(goal, start, upright))
    assert refused.value.problem.field == "path_constraint.group"
    for name in TIPS:
        plan = pandas.plan(request(goal, start, upright.model_copy(update={"group": name})))
        axes = np.array([tip(name, np.array(q))[:3, 2] for q in plan.trajectory.position])
        assert np.abs(axes - (0.0, 0.0, -1.0)).max() < 0.03


def test_beside_another_motion_no_relative_pose_is_held(pandas: Handlers, start: tuple[float, ...]) -> None:
    moving = pandas.plan(PlanRequest(goal=pose(0.5, -0.3, 0.4), start=start, group="right", optimize_s=0.0))
    in_plane = PathConstraint(axes=(False, False, False, False, False, True), relative_to="right")
    with pytest.raises(InvalidRequest, match="beside another motion") as refused:
        pandas.plan(
            PlanRequest(
                goal=pose(0.5, 0.3, 0.3),
                group="left",
                path_constraint=in_plane,
                concurrent=moving.trajectory,
                optimize_s=0.0,
            )
        )
    assert refused.value.problem.field == "path_constraint.relative_to"
