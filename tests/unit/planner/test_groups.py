"""A robot with several arms: one group moves while the others stand, or several move together."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from support.composed import composed, torso_with_arms, two_pandas
from zarm_contract.errors import InvalidRequest, PlanningFailed, ZarmError
from zarm_contract.messages import (
    AddObjects,
    AttachObject,
    Cuboid,
    DetachObject,
    FkRequest,
    Goal,
    GroupGoal,
    GroupsGoal,
    IkRequest,
    JointGoal,
    LineGoal,
    Move,
    Plan,
    PlanRequest,
    Pose,
    PoseGoal,
    ProgramRequest,
    SceneEdit,
    Sphere,
    StartState,
    TipFrame,
)
from zarm_contract.robot import RobotDescription, load_robot
from zarm_geometry.exact import ExactScene
from zarm_geometry.frames import matrix, pose_of
from zarm_geometry.robot_model import RobotModel
from zarm_geometry.world import World
from zarm_planner.group import Group
from zarm_planner.handlers import Handlers
from zarm_planner.scene.store import SceneStore
from zarm_trajectory.limits import Limits
from zarm_trajectory.trajectory import TimedTrajectory

LEFT, RIGHT = np.arange(7), np.arange(7, 14)
DOWN = (1.0, 0.0, 0.0, 0.0)
EMPTY = World((), 0.0)


@cache
def described(name: str) -> RobotDescription:
    with tempfile.TemporaryDirectory() as folder:
        return load_robot(str({"pandas": two_pandas, "torso": torso_with_arms}[name](Path(folder))))


PANDAS = RobotModel.of(described("pandas"))
HOME = np.array(PANDAS.robot.descriptor.home)
TORSO = RobotModel.of(described("torso"))


@pytest.fixture
def pandas(tmp_path: Path) -> Handlers:
    return Handlers(PANDAS, "pandas", SceneStore(tmp_path), lambda: HOME)


@pytest.fixture
def torso(tmp_path: Path) -> Handlers:
    home = np.array(TORSO.robot.descriptor.home)
    return Handlers(TORSO, "torso_arms", SceneStore(tmp_path), lambda: home)


def pose(x: float, y: float, z: float) -> PoseGoal:
    return PoseGoal(kind="pose", position=(x, y, z), orientation=DOWN)


def together(**goals: PoseGoal | JointGoal) -> GroupsGoal:
    return GroupsGoal(
        kind="groups", goals=tuple(GroupGoal(group=name.replace("__", "+"), goal=goal) for name, goal in goals.items())
    )


def request(goal: Goal, **fields: object) -> PlanRequest:
    return PlanRequest(goal=goal, optimize_s=0.0, **fields)  # type: ignore[arg-type]


def verified(model: RobotModel, plan: Plan) -> np.ndarray:  # type: ignore[type-arg]
    """The positions (n, dof) of a plan, which keeps the limits and touches nothing."""
    trajectory = TimedTrajectory.of(plan.trajectory, model.robot.descriptor.joints)
    Limits.of(model.robot).check(trajectory)
    dense = trajectory.positions(np.linspace(0.0, trajectory.duration, 500))
    assert ExactScene(model, EMPTY).nearest(dense).distance > 0.0
    return trajectory.position


def at(model: RobotModel, link: str, q: np.ndarray) -> Pose:  # type: ignore[type-arg]
    return pose_of(model.fk_link(link, q))


def test_one_arm_moves_to_a_pose_of_its_tip_and_the_other_stands(pandas: Handlers) -> None:
    plan = pandas.plan(request(pose(0.45, -0.25, 0.3), group="right"))
    path = verified(PANDAS, plan)
    assert np.ptp(path[:, LEFT], axis=0).max() == 0.0
    assert np.array(plan.tip.position) == pytest.approx((0.45, -0.25, 0.3), abs=1e-4)
    assert at(PANDAS, "right_panda_grasptarget", path[-1]).position == pytest.approx((0.45, -0.25, 0.3), abs=1e-4)
    assert plan.trajectory.joint_names == PANDAS.robot.descriptor.joints


def test_the_arm_that_stands_is_an_obstacle(pandas: Handlers) -> None:
    tip = at(PANDAS, "left_panda_grasptarget", HOME).position
    with pytest.raises(PlanningFailed, match="left_panda") as refused:
        pandas.plan(request(pose(*tip), group="right"))
    assert refused.value.problem.code == "goal_in_collision"


def test_an_arm_goes_around_the_other(pandas: Handlers) -> None:
    """The left arm stands across the way: straight in joint space, the right one would touch it."""
    standing = (-0.15, 0.49, -1.05, -1.23, 0.73, 0.95, -1.56)
    begin, goal = (0.96, -0.36, -0.2, -0.88, -0.22, 0.04, 1.12), (-0.14, 0.84, 0.56, -0.88, 1.3, 2.37, -1.36)
    straight = np.hstack((np.tile(standing, (200, 1)), np.linspace(begin, goal, 200)))
    assert set(ExactScene(PANDAS, EMPTY).nearest(straight).pair or ()) == {"right_panda_hand", "left_panda_link5"}
    assert not ExactScene(PANDAS, EMPTY).is_free(straight)
    plan = pandas.plan(request(JointGoal(kind="joints", position=goal), group="right", start=(*standing, *begin)))
    path = verified(PANDAS, plan)
    assert np.abs(path[-1][RIGHT] - goal).max() < 1e-6
    assert np.ptp(path[:, LEFT], axis=0).max() == 0.0


def test_both_arms_reach_their_poses_in_one_motion(pandas: Handlers) -> None:
    """They cross: each goes to where the other's side is, above and below."""
    plan = pandas.plan(request(together(left=pose(0.5, -0.1, 0.55), right=pose(0.45, 0.1, 0.2))))
    path = verified(PANDAS, plan)
    assert at(PANDAS, "left_panda_grasptarget", path[-1]).position == pytest.approx((0.5, -0.1, 0.55), abs=1e-4)
    assert at(PANDAS, "right_panda_grasptarget", path[-1]).position == pytest.approx((0.45, 0.1, 0.2), abs=1e-4)
    moved = np.ptp(path, axis=0)
    assert moved[LEFT].max() > 0.1
    assert moved[RIGHT].max() > 0.1


def test_a_goal_that_only_the_arms_together_miss_is_refused(pandas: Handlers) -> None:
    same = pose(0.45, 0.0, 0.3)
    for name in ("left", "right"):
        pandas.plan(request(same, group=name))
    with pytest.raises(PlanningFailed, match="in collision") as refused:
        pandas.plan(request(together(left=same, right=same)))
    assert refused.value.problem.code == "goal_in_collision"


def test_without_a_group_all_joints_move(pandas: Handlers) -> None:
    goal = HOME + 0.2
    path = verified(PANDAS, pandas.plan(request(JointGoal(kind="joints", position=tuple(goal)))))
    assert np.abs(path[-1] - goal).max() < 1e-6


def test_a_torso_moves_along_with_an_arm_or_stands(torso: Handlers) -> None:
    home = np.array(TORSO.robot.descriptor.home)
    away = home.copy()
    away[:8] += (0.3, -0.2, 0.1, 0.05, 0.2, 0.1, -0.2, 0.02)
    tip = at(TORSO, "left_rod", away)
    goal = PoseGoal(kind="pose", position=tip.position, orientation=tip.orientation)
    path = verified(TORSO, torso.plan(request(goal, group="torso+left")))
    assert at(TORSO, "left_rod", path[-1]).position == pytest.approx(goal.position, abs=1e-4)
    assert np.ptp(path[:, 8:], axis=0).max() == 0.0
    joints = JointGoal(kind="joints", position=(0.1, 0.2, 0.3, 0.05))
    path = verified(TORSO, torso.plan(request(joints, group="left")))
    assert np.ptp(np.delete(path, [4, 5, 6, 7], axis=1), axis=0).max() == 0.0


def test_an_arm_is_solved_where_the_torso_will_carry_it(torso: Handlers) -> None:
    away = np.array(TORSO.robot.descriptor.home)
    away += (0.4, -0.2, 0.1, 0.05, 0.2, 0.1, -0.2, 0.02, -0.2, 0.1, 0.1, 0.02)
    joints = JointGoal(kind="joints", position=tuple(away[:8].tolist()))
    tip = at(TORSO, "right_rod", away)
    right = PoseGoal(kind="pose", position=tip.position, orientation=tip.orientation)
    for goal in (together(torso__left=joints, right=right), together(right=right, torso__left=joints)):
        path = verified(TORSO, torso.plan(request(goal)))
        assert path[-1][:8] == pytest.approx(away[:8], abs=1e-6)
        assert at(TORSO, "right_rod", path[-1]).position == pytest.approx(tip.position, abs=1e-4)


def test_a_line_of_one_tip_is_straight(pandas: Handlers) -> None:
    tip = np.array(at(PANDAS, "right_panda_grasptarget", HOME).position)
    plan = pandas.plan(request(LineGoal(kind="line", position=tuple(tip - (0, 0, 0.15))), group="right"))
    tips = PANDAS.fk_link("right_panda_grasptarget", verified(PANDAS, plan))[:, :3, 3]
    assert np.abs(tips[:, :2] - tip[:2]).max() < 1e-4


def test_kinematics_of_a_group(pandas: Handlers) -> None:
    tip = pandas.fk(FkRequest(joints=(tuple(HOME),), group="right")).poses[0]
    solutions = pandas.ik(IkRequest(poses=(tip,), group="right", max_solutions=4)).solutions[0]
    assert len(solutions) > 1
    for q in solutions:
        assert at(PANDAS, "right_panda_grasptarget", np.concatenate((HOME[LEFT], q))).position == pytest.approx(
            tip.position, abs=1e-5
        )


def test_an_object_is_carried_by_the_link_that_it_is_attached_to(pandas: Handlers) -> None:
    tip = np.array(at(PANDAS, "right_panda_grasptarget", HOME).position)
    box = Cuboid(kind="cuboid", name="box", position=tuple(tip), size=(0.05, 0.05, 0.05))
    pandas.edit(SceneEdit(edit=AddObjects(op="add", objects=(box,))))
    link = "right_panda_grasptarget"
    touch = ("right_panda_hand", "right_panda_leftfinger", "right_panda_rightfinger")
    scene = pandas.edit(SceneEdit(edit=AttachObject(op="attach", name="box", touch_links=touch, link=link)))
    assert scene.attached[0].link == link
    assert scene.attached[0].object.position == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)  # type: ignore[union-attr]
    moved = HOME.copy()
    moved[RIGHT] += 0.3
    plan = pandas.plan(request(JointGoal(kind="joints", position=tuple(moved[RIGHT])), group="right"))
    assert plan.clearance > 0.0
    edit = DetachObject(op="detach", name="box", joints=tuple(moved))
    (put,) = pandas.edit(SceneEdit(edit=edit)).objects
    assert put.position == pytest.approx(at(PANDAS, link, moved).position, abs=1e-6)  # type: ignore[union-attr]
    with pytest.raises(InvalidRequest, match="nose is not a link of the robot"):
        pandas.edit(SceneEdit(edit=AttachObject(op="attach", name="box", link="nose")))


def test_a_program_moves_one_arm_then_the_other_then_both(pandas: Handlers) -> None:
    segments = (
        Move(kind="move", goal=pose(0.45, -0.3, 0.3), group="right"),
        Move(kind="move", goal=pose(0.45, 0.3, 0.3), group="left"),
        Move(kind="move", goal=together(left=pose(0.4, 0.35, 0.4), right=pose(0.4, -0.35, 0.4))),
    )
    plan, _ = pandas.program(ProgramRequest(segments=segments))
    path = verified(PANDAS, plan)
    time = np.array(plan.trajectory.time)
    first, second = (time <= plan.segments[0].end), (time >= plan.segments[1].begin) & (time <= plan.segments[1].end)
    assert np.ptp(path[first][:, LEFT], axis=0).max() == 0.0
    assert np.ptp(path[second][:, RIGHT], axis=0).max() == 0.0
    assert plan.tip.position == pytest.approx((0.4, 0.35, 0.4), abs=1e-4)


MOVING = StartState(position=tuple(HOME), velocity=(0.1, *[0.0] * 13), acceleration=(0.0,) * 14)


@pytest.mark.parametrize(
    ("asked", "fault"),
    [
        (request(pose(0.4, 0.3, 0.4)), r"several tips; name one of the groups left, right \(group\)"),
        (request(pose(0.4, 0.3, 0.4), group="up"), r"no group up; its groups are left, right \(group\)"),
        (request(together(left=pose(0.4, 0.3, 0.4)), group="left"), r"leave this out \(group\)"),
        (
            request(together(left=pose(0.4, 0.3, 0.4), up=pose(0.4, 0.3, 0.4))),
            r"no group up; .*\(goal.goals.1.group\)",
        ),
        (request(JointGoal(kind="joints", position=tuple(HOME)), group="left"), "14 values for the 7 joints"),
        (
            request(JointGoal(kind="joints", position=tuple(HOME[RIGHT])), group="right", start_state=MOVING),
            "left_panda_joint1 moves, but is not of the group",
        ),
    ],
)
def test_what_a_group_cannot_do_is_refused_by_field(pandas: Handlers, asked: PlanRequest, fault: str) -> None:
    with pytest.raises(ZarmError, match=fault):
        pandas.plan(asked)


def test_groups_that_share_a_joint_do_not_follow_two_goals(torso: Handlers) -> None:
    goals = together(torso__left=pose(0.4, 0.3, 0.4), torso__right=pose(0.4, -0.3, 0.4))
    with pytest.raises(InvalidRequest, match=r"torso\+right and torso\+left share the joint torso_turn"):
        torso.plan(request(goals))


def test_a_robot_with_one_arm_has_no_groups(tmp_path: Path) -> None:
    panda = RobotModel.of(load_robot("panda"))
    home = np.array(panda.robot.descriptor.home)
    handlers = Handlers(panda, "panda", SceneStore(tmp_path), lambda: home)
    with pytest.raises(InvalidRequest, match="has no group left; it is one arm: leave the group out"):
        handlers.plan(request(pose(0.4, 0.0, 0.4), group="left"))


def test_what_was_measured_of_the_whole_robot_serves_its_groups(pandas: Handlers) -> None:
    """The room between its links and covers of their shapes take 0.3 s, which no plan of a group pays again."""
    scene = pandas.scenes.present(margin=0.005, self_margin=0.003)
    room = scene.exact.model.pair_room
    group = Group.of(PANDAS.robot, "left", pose(0.45, 0.25, 0.4))
    assert group is not None
    whole = group.scene(scene, HOME).exact.model.whole
    assert whole is not None
    assert whole.model.pair_room is room


def test_fk_of_any_frame_is_that_of_the_tip_moved_there(pandas: Handlers) -> None:
    q = tuple((HOME + 0.1).tolist())
    (tip,) = pandas.fk(FkRequest(joints=(q,), group="right")).poses
    link = PANDAS.robot.group("right").descriptor.tip_link
    (found,) = pandas.fk(FkRequest(joints=(q,), tip=TipFrame(link=link))).poses
    assert found == tip
    offset = Pose(position=(0.1, 0.0, 0.2))
    (moved,) = pandas.fk(FkRequest(joints=(q,), tip=TipFrame(link=link, offset=offset))).poses
    expected = matrix(tip.position, tip.orientation) @ matrix(offset.position, offset.orientation)
    assert moved.position == pytest.approx(tuple(expected[:3, 3]))
    with pytest.raises(InvalidRequest, match="the tip names the frame already; leave the group out"):
        pandas.fk(FkRequest(joints=(q,), group="right", tip=TipFrame(link=link)))
    with pytest.raises(InvalidRequest, match="elbow is neither a link that the joints move nor an attached object"):
        pandas.fk(FkRequest(joints=(q,), tip=TipFrame(link="elbow")))


CARRIED = """
name: carried
parts:
  lower: {robot: ur10e}
  upper: {robot: panda, on: lower}
"""


def test_standing_joints_hold_what_moves_by_torque_too(tmp_path: Path) -> None:
    model = RobotModel.of(load_robot(str(composed(tmp_path, CARRIED))))
    sideways = np.array(model.robot.descriptor.home)
    sideways[[3, 4, 7, 9]] = 0.7, 3.14, 0.8, -0.8  # the Panda stands on a wrist whose axis is level
    handlers = Handlers(model, "carried", SceneStore(tmp_path), lambda: sideways)
    asked = request(
        JointGoal(kind="joints", position=tuple((sideways[6:] - [0.8, *[0.0] * 6]).tolist())), group="upper"
    )
    plan = handlers.plan(asked)
    assert plan.torque is not None
    assert model.dynamics is not None
    motion = TimedTrajectory.of(plan.trajectory, model.robot.descriptor.joints)
    times = np.linspace(0.0, motion.duration, 2000)
    shares = np.abs(model.dynamics.torque(*motion.sample(times))) / model.dynamics.limit
    assert plan.torque.joint == model.robot.descriptor.joints[shares.max(axis=0).argmax()]
    assert plan.torque.share == pytest.approx(shares.max(), abs=0.01)
    hand = model.fk_link("upper_panda_hand", sideways)
    load = Sphere(kind="sphere", name="load", position=tuple((hand[:3] @ (0.0, 0.0, 0.2, 1.0)).tolist()), radius=0.02)
    handlers.edit(SceneEdit(edit=AddObjects(op="add", objects=(load,))))
    touched = tuple(link for link in model.links if link.startswith("upper"))
    attach = AttachObject(op="attach", name="load", link="upper_panda_hand", mass=2.0, touch_links=touched)
    handlers.edit(SceneEdit(edit=attach))
    with pytest.raises(PlanningFailed, match=r"lower_wrist_3_joint would need 55 Nm at 0\.00 s"):
        handlers.plan(asked)
