"""Plans by services of ROS: against a planner, an executor and a bridge that run, with plain types."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import Point, Pose, Quaternion
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from curobo_msgs.srv import Fk, GetPlanners, SetPlanner, TrajectoryGeneration
from support.harness import eventually
from support.ros.node import answer
from support.ros.stack import KEYS, Stack, stack
from zarm_contract.messages import CancelRequest, ExecuteRequest
from zarm_contract.robot import ROBOTS, load_robot

ROBOT = load_robot("doosan_m1013")
JOINTS, HOME = ROBOT.descriptor.joints, ROBOT.descriptor.home
SPEED = np.array(ROBOT.descriptor.cspace.velocity)
DOWN = Quaternion(x=1.0, y=0.0, z=0.0, w=0.0)

# The call of the first tutorial, whose orientation is left to its default.
TUTORIAL = Pose(position=Point(x=0.5, y=0.2, z=0.3), orientation=Quaternion(w=1.0))
PLANNERS = {
    "classic": 0,
    "mpc": 1,
    "batch": 2,
    "constrained": 3,
    "multipoint": 4,
    "joint_space": 5,
    "retarget": 6,
}


def down(x: float, y: float, z: float) -> Pose:
    return Pose(position=Point(x=x, y=y, z=z), orientation=DOWN)


FAR = down(3.0, 0.0, 0.5)


@pytest.fixture(scope="module")
def descriptor(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A robot's file of the tests' own, to be changed."""
    folder = tmp_path_factory.mktemp("robot")
    for file in ("doosan_m1013.yaml", "doosan_m1013.urdf"):
        (folder / file).write_bytes((ROBOTS / file).read_bytes())
    return folder / "doosan_m1013.yaml"


@pytest.fixture(scope="module")
def running(descriptor: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    with stack(tmp_path_factory.mktemp("stack"), robot=str(descriptor)) as processes:
        yield processes


@pytest.fixture
def arm(running: Stack) -> Stack:
    """The same with the planner that is active after a start."""
    assert choose(running, "classic").success
    return running


def choose(arm: Stack, planner: str) -> Any:
    return arm.ros.call(SetPlanner, "set_planner", planner_type=PLANNERS[planner])


def generate(arm: Stack, **request: Any) -> Any:
    return arm.ros.call(TrajectoryGeneration, "generate_trajectory", **request)


def tip(arm: Stack, *positions: Any) -> list[np.ndarray]:
    """Position and quaternion (7,) of the tip with the joints at each of these."""
    states = [JointState(position=list(position)) for position in positions]
    poses = arm.ros.call(Fk, "fk", joint_states=states).poses
    return [as_row(pose) for pose in poses]


def as_row(pose: Pose) -> np.ndarray:
    p, q = pose.position, pose.orientation
    row = np.array([p.x, p.y, p.z, q.x, q.y, q.z, q.w])
    return row * np.append(np.ones(3), np.full(4, np.sign(row[3:][np.argmax(np.abs(row[3:]))])))


def assert_sound(response: Any, start: Any) -> np.ndarray:
    """A motion from the start to rest at equal steps, within the limits; returns its positions (n, joints)."""
    assert response.success, response.message
    assert response.dt == ROBOT.descriptor.interpolation_dt
    assert {tuple(state.name) for state in response.trajectory} == {JOINTS}
    position = np.array([state.position for state in response.trajectory])
    velocity = np.array([state.velocity for state in response.trajectory])
    np.testing.assert_allclose(position[0], start, atol=1e-6)
    np.testing.assert_allclose(velocity[[0, -1]], 0.0, atol=1e-6)
    assert np.all(np.abs(velocity) <= SPEED * 1.001)
    moved = np.diff(position, axis=0)
    assert np.all(np.abs(moved) <= SPEED * response.dt * 1.001)
    np.testing.assert_allclose(moved / response.dt, (velocity[1:] + velocity[:-1]) / 2, atol=0.06)
    return position


def measured(arm: Stack) -> tuple[float, ...]:
    with_latest = arm.bus.latest(KEYS.joint_states)
    state = None
    while state is None:
        state = with_latest.get(max_age=1.0)
    return state.position


@pytest.mark.parametrize("place", [(0.5, 0.2, 0.3), pytest.param((0.5, 0.0, 0.4), marks=pytest.mark.slow)])
def test_the_tutorial_s_calls_are_planned_from_the_robot(arm: Stack, place: Any) -> None:
    pose = Pose(position=Point(x=place[0], y=place[1], z=place[2]), orientation=Quaternion(w=1.0))
    response = generate(arm, target_pose=pose)
    position = assert_sound(response, measured(arm))
    np.testing.assert_allclose(tip(arm, position[-1])[0], as_row(pose), atol=1e-5)
    assert re.search(r"planned \d+\.\d\d s of motion to target_pose", response.message)


def test_the_last_plan_on_the_bus_is_the_one_that_was_answered(arm: Stack) -> None:
    position = assert_sound(generate(arm, target_pose=down(0.4, 0.3, 0.5)), HOME)
    last = arm.bus.read(KEYS.plans, timeout=10).trajectory.position[-1]
    np.testing.assert_allclose(position[-1], last, atol=1e-9)


def test_a_start_is_read_by_name(arm: Stack) -> None:
    start = (0.3, 0.1, 1.4, 0.1, 1.3, 0.2)
    given = JointState(name=["gripper", *JOINTS[::-1]], position=[0.5, *start[::-1]])
    assert_sound(generate(arm, start_pose=given, target_pose=down(0.5, -0.2, 0.5)), start)
    assert_sound(generate(arm, start_pose=JointState(position=start), target_joint_positions=HOME), start)


@pytest.mark.parametrize("planner", [name for name in PLANNERS if name not in ("mpc", "retarget")])
def test_every_planner_plans_to_the_goal_that_it_reads(arm: Stack, planner: str) -> None:
    assert choose(arm, planner).success
    goals = {
        "target_pose": down(0.5, 0.2, 0.5),
        "target_poses": [down(0.55, 0.0, 0.5), down(0.4, -0.3, 0.5)],
        "target_joint_positions": [0.5, *HOME[1:]],
    }
    position = assert_sound(generate(arm, **goals), HOME)
    end = tip(arm, position[-1])[0]
    if planner in ("classic", "constrained"):
        np.testing.assert_allclose(end, as_row(goals["target_pose"]), atol=1e-5)
    elif planner == "joint_space":
        np.testing.assert_allclose(position[-1], goals["target_joint_positions"], atol=1e-6)
    elif planner == "multipoint":
        np.testing.assert_allclose(end, as_row(goals["target_poses"][1]), atol=1e-5)
        passed = np.array(tip(arm, *position))[:, :3]
        assert np.linalg.norm(passed - as_row(goals["target_poses"][0])[:3], axis=1).min() < 0.015
        assert not np.any(np.all(np.abs(np.diff(position[2:-2], axis=0)) < 1e-7, axis=1)), "it stops on the way"
    else:
        assert any(np.allclose(end, as_row(pose), atol=1e-5) for pose in goals["target_poses"])


def test_of_a_batch_the_nearest_reachable_pose_is_chosen(arm: Stack) -> None:
    choose(arm, "batch")
    start = tip(arm, HOME)[0]
    turn = Quaternion(x=start[3], y=start[4], z=start[5], w=start[6])
    near, behind = (Pose(position=Point(x=x, y=0.1, z=0.5), orientation=turn) for x in (0.5, -0.5))
    response = generate(arm, target_poses=[FAR, behind, near])
    np.testing.assert_allclose(tip(arm, response.trajectory[-1].position)[0], as_row(near), atol=1e-5)
    assert "target_poses[2]" in response.message
    nothing = generate(arm, target_poses=[FAR, FAR])
    assert not nothing.success
    assert "(target_poses" in nothing.message


@pytest.mark.parametrize("planner", ["classic", "constrained", "joint_space"])
def test_held_axes_stay_as_they_are_all_the_way(arm: Stack, planner: str) -> None:
    choose(arm, planner)
    start = tip(arm, HOME)[0]
    goal = Pose(position=Point(x=start[0], y=start[1] + 0.25, z=start[2]), orientation=DOWN)
    goal.orientation = Quaternion(x=start[3], y=start[4], z=start[5], w=start[6])
    there = generate(arm, target_pose=goal).trajectory[-1].position
    request = {"target_pose": goal} if planner != "joint_space" else {"target_joint_positions": there}
    position = assert_sound(generate(arm, **request, trajectory_constraints=[1, 1, 1, 1, 0, 1]), HOME)
    poses = np.array(tip(arm, *position))
    assert np.abs(poses[:, [0, 2]] - start[[0, 2]]).max() < 0.0051
    assert (2 * np.arccos(np.clip(np.abs(poses[:, 3:] @ start[3:]), 0, 1))).max() < 0.021 * math.sqrt(3)


def test_constraints_equal_for_all_poses_are_held(arm: Stack) -> None:
    choose(arm, "multipoint")
    start = tip(arm, HOME)[0]
    turn = Quaternion(x=start[3], y=start[4], z=start[5], w=start[6])
    poses = [Pose(position=Point(x=start[0], y=start[1] + y, z=start[2]), orientation=turn) for y in (0.1, 0.2)]
    level = [0, 0, 0, 0, 0, 1]
    position = assert_sound(generate(arm, target_poses=poses, trajectories_contraints=level * 2), HOME)
    assert np.abs(np.array(tip(arm, *position))[:, 2] - start[2]).max() < 0.0051
    refused = generate(arm, target_poses=poses, trajectories_contraints=level + [0] * 6)
    assert not refused.success
    assert refused.message.endswith("(trajectories_contraints)")
    assert not refused.trajectory


REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "nothing": ({}, "target_pose"),
    "two goals, none of them the planner's": (
        {"target_poses": [TUTORIAL], "target_joint_positions": [0.0] * 6},
        "target_poses",
    ),
    "out of reach": ({"target_pose": FAR}, "target_pose"),
    "a turn that is none": (
        {"target_pose": Pose(position=TUTORIAL.position, orientation=Quaternion(x=1.0, y=1.0, w=0.0))},
        "target_pose.orientation",
    ),
    "no number": ({"target_pose": Pose(position=Point(x=math.nan))}, "target_pose.position.x"),
    "a waypoint out of reach": ({"target_poses": [TUTORIAL, FAR]}, "target_poses.1"),
    "too few joints": ({"target_joint_positions": [0.0] * 5}, "target_joint_positions"),
    "joints out of range": (
        {"target_joint_positions": [0.0, 0.0, 9.0, 0.0, 0.0, 0.0]},
        "target_joint_positions.position.2",
    ),
    "another robot's start": (
        {"start_pose": JointState(name=["a", "b"], position=[0.0, 0.0]), "target_pose": TUTORIAL},
        "start_pose.name",
    ),
    "a start out of range": (
        {"start_pose": JointState(position=[0.0, 9.0, 0.0, 0.0, 0.0, 0.0]), "target_pose": TUTORIAL},
        "start_pose.1",
    ),
    "five constraints": ({"target_pose": TUTORIAL, "trajectory_constraints": [0] * 5}, "trajectory_constraints"),
    "a hold that the goal breaks": (
        {"target_pose": down(0.5, 0.2, 0.3), "trajectory_constraints": [0, 0, 0, 0, 0, 1]},
        "target_pose",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_an_invalid_request_is_answered_by_field(arm: Stack, case: str) -> None:
    request, field = REFUSED[case]
    response = generate(arm, **request)
    assert not response.success
    assert not response.trajectory
    assert response.message.endswith(f"({field})"), response.message
    assert len(response.message) > 30 + len(field)


def test_planners_are_listed_by_the_numbers_of_their_constants(arm: Stack) -> None:
    response = arm.ros.call(GetPlanners, "get_planners")
    assert response.success
    assert dict(zip(response.planner_names, response.planner_ids, strict=True)) == PLANNERS
    assert (response.current_planner_name, response.current_planner_id) == ("classic", SetPlanner.Request.CLASSIC)


def test_set_planner_reports_both_and_sets_the_parameter(arm: Stack) -> None:
    response = choose(arm, "multipoint")
    assert (response.success, response.previous_planner, response.current_planner) == (True, "classic", "multipoint")
    assert parameter(arm, "planner_type").string_value == "multipoint"
    assert arm.ros.call(GetPlanners, "get_planners").current_planner_id == SetPlanner.Request.MULTIPOINT


def test_an_unknown_planner_is_refused_and_changes_nothing(arm: Stack) -> None:
    response = arm.ros.call(SetPlanner, "set_planner", planner_type=255)
    assert (response.success, response.previous_planner, response.current_planner) == (False, "classic", "classic")
    assert len(response.message) > 20
    assert parameter(arm, "planner_type").string_value == "classic"


def test_the_planner_parameter_selects_the_active_planner(arm: Stack) -> None:
    assert set_parameter(arm, "planner_type", "joint_space").successful
    assert arm.ros.call(GetPlanners, "get_planners").current_planner_name == "joint_space"
    refused = set_parameter(arm, "planner_type", "mppi")
    assert not refused.successful
    assert "mppi" in refused.reason
    assert arm.ros.call(GetPlanners, "get_planners").current_planner_name == "joint_space"


@pytest.mark.slow
def test_many_clients_at_once_all_get_their_plan(arm: Stack) -> None:
    client = arm.ros.node.create_client(TrajectoryGeneration, "/unified_planner/generate_trajectory")
    assert client.wait_for_service(60)
    requests = [TrajectoryGeneration.Request(target_joint_positions=[0.1 * k, *HOME[1:]]) for k in range(1, 9)]
    for k, future in enumerate([client.call_async(request) for request in requests], start=1):
        response = answer(future, "a plan is there")
        assert_sound(response, HOME)
        assert response.trajectory[-1].position[0] == pytest.approx(0.1 * k)


@pytest.mark.slow  # as they do by themselves, in process/test_reread.py
def test_an_update_makes_every_service_reload_the_robot(arm: Stack, descriptor: Path) -> None:
    goal = {"target_joint_positions": [1.0, *HOME[1:]]}
    before, fast = descriptor.read_text(), generate(arm, **goal)
    assert_sound(fast, HOME)
    processes = [arm.processes[name].process.pid for name in ("executor", "planner")]
    slow = before.replace("velocity: [1.2, 1.2, 1.2, 1.2, 1.2, 1.2]", "velocity: [0.2, 0.2, 0.2, 0.2, 0.2, 0.2]")
    try:
        descriptor.write_text(slow)
        update = arm.ros.call(Trigger, "update_motion_gen_config")
        assert update.success, update.message
        assert "executor and planner have restarted" in update.message
        response = generate(arm, **goal)
        assert response.success, response.message
        assert np.abs([state.velocity for state in response.trajectory]).max() <= 0.2 * 1.001
        assert len(response.trajectory) > 2 * len(fast.trajectory)
    finally:
        descriptor.write_text(before)
        assert arm.ros.call(Trigger, "update_motion_gen_config").success
    assert len(generate(arm, **goal).trajectory) == pytest.approx(len(fast.trajectory), abs=2)
    assert [arm.processes[name].process.pid for name in ("executor", "planner")] == processes


def test_an_update_of_a_broken_file_changes_nothing(arm: Stack, descriptor: Path) -> None:
    same = arm.ros.call(Trigger, "update_motion_gen_config")
    assert same.success, same.message
    before = descriptor.read_text()
    for wrong, named in (("interpolation_dt: soon", "interpolation_dt"), ("tip_link: link_5", "tip_link")):
        key = wrong.split(":")[0]
        line = next(line for line in before.splitlines() if line.startswith(f"{key}:"))
        try:
            descriptor.write_text(before.replace(line, wrong))
            broken = arm.ros.call(Trigger, "update_motion_gen_config")
            assert not broken.success
            assert named in broken.message
            assert str(descriptor) in broken.message
        finally:
            descriptor.write_text(before)
    assert_sound(generate(arm, target_pose=TUTORIAL), HOME)


def test_an_update_is_refused_while_the_robot_moves(arm: Stack, descriptor: Path) -> None:
    assert_sound(generate(arm, target_joint_positions=[1.0, *HOME[1:]]), HOME)
    before = descriptor.read_text()
    goal = arm.bus.call(KEYS.execute, ExecuteRequest(), timeout=10)
    try:
        descriptor.write_text(before + "\n# a remark")
        update = arm.ros.call(Trigger, "update_motion_gen_config")
        assert not update.success
        assert "running" in update.message
    finally:
        descriptor.write_text(before)
        arm.bus.call(KEYS.cancel, CancelRequest(goal_id=goal.goal_id), timeout=10)
    eventually(lambda: arm.bus.read(KEYS.executor_state, timeout=10).mode == "idle", "it rests")


def parameter(arm: Stack, name: str) -> ParameterValue:
    return arm.ros.call(GetParameters, "get_parameters", names=[name]).values[0]


def set_parameter(arm: Stack, name: str, value: str) -> Any:
    changed = Parameter(name=name, value=ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=value))
    return arm.ros.call(SetParameters, "set_parameters", parameters=[changed]).results[0]
