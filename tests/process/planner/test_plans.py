"""Plans as clients of the planner get them: a process of its own, asked over a real router."""

from __future__ import annotations

import numpy as np
import pytest

from support.harness import PATIENCE, eventually
from support.planner.client import (
    BEHIND_FENCE,
    BEHIND_POST,
    FENCE,
    HOME,
    KEYS,
    POST,
    ROBOT,
    SHELF,
    TABLE,
    assert_sound,
    load,
    plan,
    to_joints,
)
from support.planner.second_opinion import Collisions, link_pose, tip_error
from zarm_contract.errors import ExecutionRefused, InvalidRequest, PlanningFailed
from zarm_contract.messages import (
    CheckRequest,
    Cuboid,
    JointState,
    Plan,
    PlanRequest,
    PoseGoal,
    WaypointsGoal,
)
from zarm_executor.checks import executable
from zarm_runtime.bus import Bus


def test_a_joint_goal_behind_an_obstacle_is_reached_around_it(planner: Bus) -> None:
    objects = (TABLE, POST, SHELF)
    revision = load(planner, *objects).revision
    assert any(map(Collisions(ROBOT, objects).at, np.linspace(HOME, BEHIND_POST, 100)))
    answer = plan(planner, PlanRequest(start=HOME, goal=to_joints(*BEHIND_POST)))
    assert np.allclose(assert_sound(answer, HOME, objects), BEHIND_POST, atol=1e-6)
    assert answer.scene_revision == revision
    assert answer.robot == "doosan_m1013"
    assert answer.robot_hash == ROBOT.hash
    assert 0.0 < answer.clearance < 0.1
    assert answer.timings.total >= answer.timings.search + answer.timings.verify > 0.0


def test_a_pose_goal_is_reached_to_a_tenth_of_a_millimetre(planner: Bus) -> None:
    objects = (TABLE, POST, SHELF)
    load(planner, *objects)
    goal = PoseGoal(kind="pose", position=(0.3, 0.6, 0.3), orientation=(1.0, 0.0, 0.0, 0.0))
    answer = plan(planner, PlanRequest(start=HOME, goal=goal))
    end = assert_sound(answer, HOME, objects)
    distance, angle = tip_error(ROBOT, end, goal.position, goal.orientation)
    assert distance < 1e-4
    assert angle < 1e-4
    assert np.allclose(answer.tip.position, goal.position, atol=1e-4)


def test_the_same_request_gives_the_same_motion(planner: Bus) -> None:
    load(planner, TABLE, POST, SHELF)
    request = PlanRequest(start=HOME, goal=to_joints(*BEHIND_POST), optimize_s=0.0, seed=7)
    first, again = plan(planner, request), plan(planner, request)
    assert first.trajectory == again.trajectory
    assert first.plan_id != again.plan_id
    assert (
        plan(planner, request.model_copy(update={"seed": 8})).trajectory.position[-1] == first.trajectory.position[-1]
    )


def test_scales_make_the_motion_slower(planner: Bus) -> None:
    load(planner)
    goal = to_joints(1.0, *HOME[1:])
    full = plan(planner, PlanRequest(start=HOME, goal=goal))
    slow = plan(planner, PlanRequest(start=HOME, goal=goal, velocity_scale=0.25, acceleration_scale=0.25))
    fastest = np.abs(slow.trajectory.velocity).max(axis=0)
    assert np.all(fastest <= 0.25 * np.array(ROBOT.descriptor.cspace.velocity) * 1.002)
    assert slow.trajectory.duration > 1.9 * full.trajectory.duration


def test_a_robot_at_its_goal_gets_a_motion_that_stands_still(planner: Bus) -> None:
    load(planner)
    answer = plan(planner, PlanRequest(start=HOME, goal=to_joints(*HOME)))
    assert set(answer.trajectory.position) == {HOME}
    assert answer.path_length == 0.0


def test_a_robot_close_to_a_surface_can_leave_it(planner: Bus) -> None:
    """The spheres that the search works with stand out of the links; what touches nothing exactly must not be stuck."""
    low = (0.0, 0.5, 1.8, 0.0, 0.8, 0.0)
    load(planner)
    free = planner.call(KEYS.check, CheckRequest(joints=(low,)), timeout=PATIENCE).results[0]
    assert not free.in_collision
    flange = link_pose(ROBOT, "link_6", low)[:3, 3]

    def plate(height: float) -> Cuboid:
        return Cuboid(kind="cuboid", name="plate", position=(*flange[:2].tolist(), height), size=(0.3, 0.3, 0.02))

    heights = np.arange(flange[2] - 0.3, flange[2], 0.001).tolist()
    touching = next(height for height in heights if Collisions(ROBOT, (plate(height),)).at(low))
    just_below = plate(touching - 0.002)
    load(planner, just_below)
    answer = plan(planner, PlanRequest(start=low, goal=to_joints(*HOME)))
    assert answer.clearance < 0.003
    assert_sound(answer, low, (just_below,))


def test_the_measured_state_is_the_default_start(planner: Bus) -> None:
    load(planner)
    with pytest.raises(ExecutionRefused) as caught:
        plan(planner, PlanRequest(goal=to_joints(*HOME)))
    assert caught.value.code == "no_joint_state"
    states = planner.publisher(KEYS.joint_states)
    order = (0, 1, 3, 4, 2, 5)  # as the driver on ROS Humble does
    names = tuple(ROBOT.descriptor.joints[i] for i in order)
    measured = (0.1, 0.2, 1.3, 0.4, 1.5, 0.6)
    state = JointState(
        stamp=0.0, joint_names=names, position=tuple(measured[i] for i in order), velocity=(0.0,) * len(names)
    )

    def planned() -> Plan | None:
        states.put(state)
        try:
            return plan(planner, PlanRequest(goal=to_joints(*HOME)))
        except ExecutionRefused:
            return None

    answer = eventually(planned, "the planner has received the measured state")
    assert np.allclose(answer.trajectory.position[0], measured, atol=1e-9)


def test_measured_states_that_lack_a_joint_are_no_start(planner: Bus) -> None:
    load(planner)
    states = planner.publisher(KEYS.joint_states)
    state = JointState(stamp=0.0, joint_names=("joint_1",), position=(0.0,), velocity=(0.0,))

    def refusal() -> str | None:
        states.put(state)
        try:
            plan(planner, PlanRequest(goal=to_joints(*HOME)))
        except ExecutionRefused as refused:
            return refused.problem.joint
        return None

    assert eventually(refusal, "the planner has received the state") == "joint_2"


def test_one_motion_leads_through_waypoints_of_both_kinds(planner: Bus) -> None:
    objects = (TABLE, POST, SHELF)
    load(planner, *objects)
    pose = plan(planner, PlanRequest(start=HOME, goal=to_joints(*BEHIND_POST))).tip
    goal = WaypointsGoal(
        kind="waypoints",
        through=(
            PoseGoal(kind="pose", position=pose.position, orientation=pose.orientation),
            to_joints(0.8, -0.3, 1.2, 0.0, 1.5, 0.2),
            to_joints(*HOME),
        ),
    )
    answer = plan(planner, PlanRequest(start=HOME, goal=goal, planner="multi_point"))
    assert np.allclose(assert_sound(answer, HOME, objects), HOME, atol=1e-6)
    path = executable(answer.trajectory, ROBOT)
    first, second, last = answer.waypoint_times
    assert 0.0 < first < second < last <= answer.trajectory.duration
    distance, angle = tip_error(ROBOT, path.at(first)[0], pose.position, pose.orientation)
    assert distance <= goal.position_tolerance
    assert angle <= goal.angle_tolerance


def test_time_to_optimise_is_spent_and_gives_no_slower_motion(planner: Bus) -> None:
    objects = (TABLE, POST, SHELF)
    load(planner, *objects)
    request = PlanRequest(start=HOME, goal=to_joints(*BEHIND_POST), optimize_s=0.0)
    quick = plan(planner, request)
    better = plan(planner, request.model_copy(update={"optimize_s": 0.3}))
    assert_sound(better, HOME, objects)
    assert quick.timings.optimize == 0.0
    assert better.timings.optimize > 0.0
    assert better.trajectory.duration <= quick.trajectory.duration


def test_a_goal_of_a_kind_the_planner_lacks_is_refused(planner: Bus) -> None:
    with pytest.raises(InvalidRequest, match="joint_space") as refused:
        plan(planner, PlanRequest(start=HOME, goal=to_joints(*HOME), planner="classic"))
    assert refused.value.problem.field == "planner"


def test_a_search_ends_after_max_attempts(planner: Bus) -> None:
    load(planner, *FENCE)
    with pytest.raises(PlanningFailed, match=r"max_attempts, 1\b") as given_up:
        plan(planner, PlanRequest(start=HOME, goal=to_joints(*BEHIND_FENCE), max_attempts=1, timeout=60.0))
    assert given_up.value.code == "no_path"
