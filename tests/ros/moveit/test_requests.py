"""Each field of a motion plan request does what MoveIt's documentation says of it."""

from __future__ import annotations

import numpy as np
import pytest
from geometry_msgs.msg import TransformStamped
from moveit_msgs.msg import (
    Constraints,
    MotionSequenceItem,
    MotionSequenceRequest,
    MoveItErrorCodes,
    PlannerParams,
    PositionIKRequest,
    RobotState,
)
from moveit_msgs.srv import (
    GetCartesianPath,
    GetGroupUrdf,
    GetMotionSequence,
    GetMultiStateValidity,
    GetPlannerParams,
    GetPositionFK,
    GetPositionIK,
    QueryPlannerInterfaces,
    SetPlannerParams,
)
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from support.harness import eventually
from support.ros.moveit import (
    DOWN,
    SUCCESS,
    angles_off,
    end_of,
    joints,
    orientation,
    planned,
    pose,
    position,
    quaternion,
    request,
)
from support.ros.stack import KEYS, Stack
from support.tiers import sampled
from zarm.connection import Connection
from zarm.robot import Robot
from zarm_contract.robot import load_robot

ROBOT = load_robot("doosan_m1013")
JOINTS, HOME = ROBOT.descriptor.joints, ROBOT.descriptor.home
LOWER, UPPER = np.array(ROBOT.lower), np.array(ROBOT.upper)
AT = (0.5, 0.2, 0.6)
E = MoveItErrorCodes


@pytest.fixture(scope="module")
def robot(arm: Stack) -> Robot:
    """The robot at home, in an empty scene."""
    robot = Robot(Connection.of(arm.bus, KEYS))
    robot.scene.clear()
    robot.execute(robot.plan(HOME))
    return robot


def at(position: tuple[float, ...] | list[float]) -> RobotState:
    return RobotState(joint_state=JointState(name=list(JOINTS), position=list(position)))


def poses_of(robot: Robot, response: object) -> np.ndarray:
    points = response.trajectory.joint_trajectory.points
    return np.array([pose.position for pose in robot.fk([list(point.positions) for point in points])])


def random_poses(robot: Robot, seed: int, count: int) -> list:
    rng = np.random.default_rng(seed)
    found = []
    while len(found) < count:
        q = rng.uniform(np.maximum(LOWER, -2.5), np.minimum(UPPER, 2.5))
        (result,) = robot.check([q])
        if not result.in_collision:
            found.append(robot.fk([q])[0])
    return found


@pytest.mark.parametrize("count", sampled(60, 200))
def test_poses_with_tolerances_end_within_them(arm: Stack, robot: Robot, count: int) -> None:
    rng = np.random.default_rng(7)
    for i, there in enumerate(random_poses(robot, 3, count)):
        vector = bool(i % 2)
        turns = [rng.choice([0.001, 0.1, 0.4, 3.15]) for _ in range(3)]
        q = there.orientation
        if i % 3 == 0:
            edges = rng.choice([0.002, 0.05, 0.3], 3)
            goal = pose(there.position, q, box=edges, tolerance=turns, rotation_vector=vector)
            inside = edges / 2
        else:
            radius = float(rng.choice([0.001, 0.03]))
            goal = pose(there.position, q, radius=radius, tolerance=turns, rotation_vector=vector)
            inside = np.full(3, radius)
        (tip,) = robot.fk([end_of(planned(arm.ros, request(goal)))])
        assert np.all(np.abs(np.subtract(tip.position, there.position)) <= inside + 1e-6), (i, tip)
        off = angles_off(q, tip.orientation, rotation_vector=vector)
        assert all(angle <= most + 1e-6 or most > 3.1 for angle, most in zip(off, turns, strict=True)), (i, off, turns)


def test_joints_end_within_their_tolerances(arm: Stack, robot: Robot) -> None:
    rng = np.random.default_rng(5)
    for _ in range(20):
        goal = rng.uniform(np.maximum(LOWER, -2.0), np.minimum(UPPER, 2.0))
        (result,) = robot.check([goal])
        response = planned(arm.ros, request(joints(JOINTS, goal)))
        if result.in_collision:
            assert response.error_code.val == E.GOAL_IN_COLLISION
        else:
            assert np.allclose(end_of(response), goal, atol=1e-3)


def test_joints_beside_a_pose_choose_the_configuration(arm: Stack, robot: Robot) -> None:
    reached = [np.array(q) for q in robot.ik(robot.fk([HOME])[0], max_solutions=64)]
    for wanted in (HOME[2], next(q[2] for q in reached if abs(q[2] - HOME[2]) > 0.5)):
        there = robot.fk([HOME])[0]
        goal = pose(there.position, there.orientation)
        goal.joint_constraints = joints(JOINTS[2:3], [wanted], 0.2).joint_constraints
        end = end_of(planned(arm.ros, request(goal)))
        assert end[2] == pytest.approx(wanted, abs=0.2)
        (tip,) = robot.fk([end])
        assert tip.position == pytest.approx(there.position, abs=1e-3)
    goal.joint_constraints = joints(JOINTS[2:3], [HOME[2] + 1.0], 0.01).joint_constraints
    assert planned(arm.ros, request(goal)).error_code.val == E.NO_IK_SOLUTION
    goal.joint_constraints = joints(["finger"], [0.0]).joint_constraints
    assert planned(arm.ros, request(goal)).error_code.val == E.INVALID_GOAL_CONSTRAINTS


def test_joints_that_are_not_constrained_keep_their_position(arm: Stack, robot: Robot) -> None:
    end = end_of(planned(arm.ros, request(joints(JOINTS[:1], [0.3]))))
    assert end == pytest.approx([0.3, *HOME[1:]], abs=1e-6)


def test_a_position_outside_the_range_is_moved_to_its_edge(arm: Stack, robot: Robot) -> None:
    beyond = UPPER[5] + 0.01
    end = end_of(planned(arm.ros, request(joints(JOINTS[5:], [beyond], tolerance=0.05))))
    assert UPPER[5] - 0.04 - 1e-6 <= end[5] <= UPPER[5] + 1e-6
    refused = planned(arm.ros, request(joints(JOINTS[5:], [beyond], tolerance=0.001)))
    assert refused.error_code.val == E.INVALID_GOAL_CONSTRAINTS
    assert "joint_6" in refused.error_code.message


def test_a_position_alone_leaves_the_orientation_free(arm: Stack, robot: Robot) -> None:
    goal = Constraints(position_constraints=[position(AT)])
    (tip,) = robot.fk([end_of(planned(arm.ros, request(goal)))])
    assert np.allclose(tip.position, AT, atol=1e-3)


def test_an_orientation_alone_leaves_the_position_free(arm: Stack, robot: Robot) -> None:
    q = Rotation.from_euler("XYZ", [3.0, 0.2, 0.5]).as_quat()
    goal = Constraints(orientation_constraints=[orientation(q)])
    (tip,) = robot.fk([end_of(planned(arm.ros, request(goal)))])
    assert np.all(angles_off(q, tip.orientation, rotation_vector=True) < 0.002)


def test_any_link_and_any_point_of_it_may_have_a_goal(arm: Stack, robot: Robot) -> None:
    goal = Constraints(position_constraints=[position((0.3, 0.3, 0.8), "link_5", offset=(0.0, 0.0, 0.1))])
    assert planned(arm.ros, request(goal)).error_code.val == SUCCESS
    offset = Constraints(
        position_constraints=[position(AT, offset=(0.0, 0.0, 0.15))], orientation_constraints=[orientation(DOWN)]
    )
    (tip,) = robot.fk([end_of(planned(arm.ros, request(offset)))])
    assert np.allclose(tip.position, (AT[0], AT[1], AT[2] + 0.15), atol=1e-3)


def test_several_goals_are_alternatives(arm: Stack, robot: Robot) -> None:
    far = pose((3.0, 0.0, 0.5))
    (tip,) = robot.fk([end_of(planned(arm.ros, request(far, pose(AT))))])
    assert np.allclose(tip.position, AT, atol=1e-3)
    end = end_of(planned(arm.ros, request(far, joints(JOINTS, HOME))))
    assert np.allclose(end, HOME, atol=1e-3)


def test_a_start_state_is_where_the_motion_begins(arm: Stack, robot: Robot) -> None:
    start = [HOME[0] + 0.7, *HOME[1:]]
    response = planned(arm.ros, request(pose(AT), start_state=at(start)))
    assert list(response.trajectory.joint_trajectory.points[0].positions) == pytest.approx(start)
    assert list(response.trajectory_start.joint_state.position) == pytest.approx(start)
    one = RobotState(joint_state=JointState(name=["joint_1"], position=[0.4]), is_diff=True)
    response = planned(arm.ros, request(pose(AT), start_state=one))
    assert list(response.trajectory_start.joint_state.position) == pytest.approx([0.4, *HOME[1:]], abs=1e-6)


def test_scales_slow_the_motion(arm: Stack, robot: Robot) -> None:
    def duration(**fields: float) -> float:
        last = planned(arm.ros, request(joints(JOINTS[:1], [1.0]), **fields)).trajectory.joint_trajectory.points[-1]
        return last.time_from_start.sec + last.time_from_start.nanosec * 1e-9

    whole = duration()
    assert duration(max_velocity_scaling_factor=0.0, max_acceleration_scaling_factor=0.0) == pytest.approx(whole)
    assert duration(max_velocity_scaling_factor=1.7) == pytest.approx(whole)
    assert duration(max_velocity_scaling_factor=0.1) > 2 * whole


def test_a_link_keeps_to_its_cartesian_speed(arm: Stack, robot: Robot) -> None:
    response = planned(
        arm.ros,
        request(joints(JOINTS[:1], [1.0]), max_cartesian_speed=0.2, cartesian_speed_limited_link="link_6"),
    )
    points = poses_of(robot, response)
    times = [
        one.time_from_start.sec + one.time_from_start.nanosec * 1e-9
        for one in response.trajectory.joint_trajectory.points
    ]
    assert np.max(np.linalg.norm(np.diff(points, axis=0), axis=1) / np.diff(times)) < 0.2 + 1e-6


def test_lin_moves_on_a_line_and_circ_on_a_circle(arm: Stack, robot: Robot) -> None:
    start = end_of(planned(arm.ros, request(pose(AT))))
    to = (AT[0], AT[1] - 0.2, AT[2])
    pilz = {"pipeline_id": "pilz_industrial_motion_planner", "start_state": at(start)}
    line = poses_of(robot, planned(arm.ros, request(pose(to), planner_id="LIN", **pilz)))
    assert np.allclose(line[:, [0, 2]], (AT[0], AT[2]), atol=2e-4)
    middle = (AT[0] + 0.1, AT[1] - 0.1, AT[2])
    center = (AT[0], AT[1] - 0.1, AT[2])
    for name, point in (("interim", middle), ("center", center)):
        via = Constraints(name=name, position_constraints=[position(point)])
        end = to if name == "interim" else (AT[0] + 0.1, AT[1] - 0.1, AT[2])
        response = planned(arm.ros, request(pose(end), planner_id="CIRC", path_constraints=via, **pilz))
        arc = poses_of(robot, response)
        assert np.allclose(np.linalg.norm(arc - center, axis=1), 0.1, atol=2e-4)
    way = Constraints(position_constraints=[position(point, turned=DOWN) for point in (middle, to)])
    polyline = poses_of(robot, planned(arm.ros, request(pose(to), planner_id="POLYLINE", path_constraints=way, **pilz)))
    assert np.allclose(polyline[-1], to, atol=1e-4)
    assert min(np.linalg.norm(polyline - middle, axis=1)) < 0.02


def test_a_sequence_is_one_motion_with_blends(arm: Stack, robot: Robot) -> None:
    corners = [AT, (AT[0], AT[1] - 0.2, AT[2]), (AT[0] - 0.1, AT[1] - 0.2, AT[2])]
    items = [MotionSequenceItem(req=request(pose(corners[0])))] + [
        MotionSequenceItem(req=request(pose(corner), planner_id="LIN"), blend_radius=radius)
        for corner, radius in zip(corners[1:], (0.05, 0.0), strict=True)
    ]
    answer = arm.ros.call(GetMotionSequence, "/plan_sequence_path", request=MotionSequenceRequest(items=items)).response
    assert answer.error_code.val == SUCCESS, answer.error_code
    (trajectory,) = answer.planned_trajectories
    points = np.array(
        [pose.position for pose in robot.fk([list(one.positions) for one in trajectory.joint_trajectory.points])]
    )
    assert np.allclose(points[-1], corners[-1], atol=1e-3)
    nearest = min(np.linalg.norm(points - corners[1], axis=1))
    assert 0.001 < nearest < 0.05


def test_path_constraints_hold_on_the_whole_way(arm: Stack, robot: Robot) -> None:
    start = end_of(planned(arm.ros, request(pose(AT))))
    upright = Constraints(orientation_constraints=[orientation(DOWN, tolerance=(0.1, 0.1, 3.15))])
    to = (AT[0] - 0.1, AT[1] - 0.5, AT[2])
    response = planned(arm.ros, request(pose(to), start_state=at(start), path_constraints=upright))
    assert response.error_code.val == SUCCESS, response.error_code
    for tip in robot.fk([list(one.positions) for one in response.trajectory.joint_trajectory.points]):
        assert np.all(angles_off(DOWN, tip.orientation, rotation_vector=False)[:2] <= 0.1 + 1e-6)
    outside = planned(
        arm.ros, request(pose(to), start_state=at([*HOME[:4], HOME[4] + 0.4, HOME[5]]), path_constraints=upright)
    )
    assert outside.error_code.val == E.START_STATE_VIOLATES_PATH_CONSTRAINTS
    turned = Rotation.from_quat(DOWN) * Rotation.from_euler("x", 0.6)
    goal = planned(arm.ros, request(pose(to, turned.as_quat()), start_state=at(start), path_constraints=upright))
    assert goal.error_code.val == E.GOAL_VIOLATES_PATH_CONSTRAINTS


def test_a_goal_with_freedom_keeps_path_constraints(arm: Stack, robot: Robot) -> None:
    start = end_of(planned(arm.ros, request(pose(AT))))
    upright = Constraints(orientation_constraints=[orientation(DOWN, tolerance=(0.1, 0.1, 3.15))])
    to = Constraints(position_constraints=[position((AT[0] - 0.1, AT[1] - 0.5, AT[2]))])
    response = planned(arm.ros, request(to, start_state=at(start), path_constraints=upright))
    assert response.error_code.val == SUCCESS, response.error_code
    for tip in robot.fk([list(one.positions) for one in response.trajectory.joint_trajectory.points]):
        assert np.all(angles_off(DOWN, tip.orientation, rotation_vector=False)[:2] <= 0.1 + 1e-6)


def test_path_constraints_are_nowhere_passed_over(arm: Stack, robot: Robot) -> None:
    start = end_of(planned(arm.ros, request(pose(AT))))
    to = (AT[0], AT[1] - 0.2, AT[2])
    turned = (Rotation.from_quat(DOWN) * Rotation.from_euler("x", 0.6)).as_quat()
    upright = Constraints(orientation_constraints=[orientation(DOWN, tolerance=(0.1, 0.1, 3.15))])
    line = request(pose(to, turned), planner_id="LIN", start_state=at(start), path_constraints=upright)
    assert planned(arm.ros, line).error_code.val == E.PLANNING_FAILED
    items = [MotionSequenceItem(req=request(pose(AT), path_constraints=upright))]
    answer = arm.ros.call(GetMotionSequence, "/plan_sequence_path", request=MotionSequenceRequest(items=items))
    assert answer.response.error_code.val == E.INVALID_MOTION_PLAN


def test_a_cartesian_path_ends_where_it_cannot_be_followed(arm: Stack, robot: Robot) -> None:
    start = end_of(planned(arm.ros, request(pose(AT))))
    waypoints = [
        pose(point).position_constraints[0].constraint_region.primitive_poses[0]
        for point in ((0.8, 0.2, 0.6), (1.6, 0.2, 0.6))
    ]
    for waypoint in waypoints:
        waypoint.orientation = quaternion(DOWN)
    answer = arm.ros.call(
        GetCartesianPath,
        "/compute_cartesian_path",
        group_name="arm",
        start_state=at(start),
        waypoints=waypoints,
        max_step=0.01,
        avoid_collisions=True,
    )
    assert answer.error_code.val == SUCCESS
    assert 0.0 < answer.fraction < 1.0
    tips = np.array(
        [pose.position for pose in robot.fk([list(one.positions) for one in answer.solution.joint_trajectory.points])]
    )
    assert np.allclose(tips[:, 1:], AT[1:], atol=2e-4)
    assert tips[-1][0] == pytest.approx(AT[0] + answer.fraction * (1.6 - AT[0]), abs=0.02)


@pytest.mark.parametrize(
    ("fields", "val", "said"),
    [
        ({"group_name": "hand"}, E.INVALID_GROUP_NAME, "hand"),
        ({"goal_constraints": []}, E.INVALID_GOAL_CONSTRAINTS, "no goal"),
        ({"goal_constraints": [Constraints()]}, E.INVALID_GOAL_CONSTRAINTS, "no goal"),
        ({"goal_constraints": [pose(AT, link="no_link")]}, E.INVALID_LINK_NAME, "no_link"),
        ({"goal_constraints": [pose(AT, frame="moon")]}, E.FRAME_TRANSFORM_FAILURE, "moon"),
        ({"goal_constraints": [pose(AT, q=(0.0, 0.0, 0.0, 0.0))]}, E.INVALID_GOAL_CONSTRAINTS, "quaternion"),
        ({"goal_constraints": [pose(AT, q=(0.0, 0.0, 0.0, 2.0))]}, E.INVALID_GOAL_CONSTRAINTS, "normalise"),
        ({"goal_constraints": [pose((float("nan"), 0.0, 0.5))]}, E.INVALID_GOAL_CONSTRAINTS, "finite"),
        ({"goal_constraints": [pose((3.0, 0.0, 0.5))]}, E.NO_IK_SOLUTION, "reached"),
        ({"goal_constraints": [joints(["no_joint"], [0.0])]}, E.INVALID_GOAL_CONSTRAINTS, "no_joint"),
        (
            {"start_state": RobotState(joint_state=JointState(name=["joint_1"], position=[]))},
            E.INVALID_ROBOT_STATE,
            "positions",
        ),
        ({"start_state": at([9.0, *HOME[1:]])}, E.START_STATE_INVALID, "joint_1"),
        ({"max_velocity_scaling_factor": -0.5}, E.INVALID_MOTION_PLAN, "negative"),
        ({"planner_id": "CIRC"}, E.INVALID_MOTION_PLAN, "interim"),
        ({"planner_id": "LIN", "goal_constraints": []}, E.INVALID_GOAL_CONSTRAINTS, "one goal"),
    ],
)
def test_what_cannot_be_meant_is_refused_by_its_field(
    arm: Stack, robot: Robot, fields: dict[str, object], val: int, said: str
) -> None:
    code = planned(arm.ros, request(**{"goal_constraints": [pose(AT)], **fields})).error_code
    assert (code.val, said in code.message) == (val, True), code


def test_poses_in_frames_of_tf_are_looked_up(arm: Stack, robot: Robot) -> None:
    static = TransformStamped(child_frame_id="table")
    static.header.frame_id = "base_link"
    static.transform.translation.x, static.transform.rotation = 0.4, quaternion((0.0, 0.0, 1.0, 0.0))
    publisher = arm.ros.node.create_publisher(TFMessage, "/tf", 10)

    def in_table() -> object:
        static.header.stamp = arm.ros.node.get_clock().now().to_msg()
        publisher.publish(TFMessage(transforms=[static]))
        response = planned(arm.ros, request(pose((-0.1, -0.2, 0.6), q=(0.0, 1.0, 0.0, 0.0), frame="table")))
        return response if response.error_code.val == SUCCESS else None

    (tip,) = robot.fk([end_of(eventually(in_table, "the frame is known"))])
    assert np.allclose(tip.position, AT, atol=1e-3)
    arm.ros.node.destroy_publisher(publisher)


def test_poses_in_frames_of_links_and_objects_are_looked_up(arm: Stack, robot: Robot) -> None:
    (home,) = robot.fk([HOME])
    response = planned(arm.ros, request(pose((0.0, 0.0, 0.05), q=(0.0, 0.0, 0.0, 1.0), frame="link_6")))
    (tip,) = robot.fk([end_of(response)])
    ahead = np.array(home.position) + Rotation.from_quat(home.orientation).apply((0.0, 0.0, 0.05))
    assert np.allclose(tip.position, ahead, atol=1e-3)


def test_planners_are_listed_and_their_settings_read_and_changed(arm: Stack, robot: Robot) -> None:
    interfaces = arm.ros.call(QueryPlannerInterfaces, "/query_planner_interface").planner_interfaces
    assert {one.pipeline_id: list(one.planner_ids) for one in interfaces} == {
        "zarm": ["free"],
        "pilz_industrial_motion_planner": ["PTP", "LIN", "CIRC", "POLYLINE"],
    }
    before = arm.ros.call(GetPlannerParams, "/get_planner_params").params
    changed = PlannerParams(keys=["velocity_scale"], values=["0.5"])
    arm.ros.call(SetPlannerParams, "/set_planner_params", params=changed)
    after = arm.ros.call(GetPlannerParams, "/get_planner_params").params
    assert dict(zip(after.keys, after.values, strict=True))["velocity_scale"] == "0.5"
    assert robot.planner.settings().velocity_scale == 0.5
    arm.ros.call(SetPlannerParams, "/set_planner_params", params=PlannerParams(keys=["warp"], values=["9"]))
    arm.ros.call(SetPlannerParams, "/set_planner_params", params=before)
    assert robot.planner.settings().velocity_scale == 1.0


def test_the_urdf_of_the_group_is_that_of_the_robot(arm: Stack, robot: Robot) -> None:
    answer = arm.ros.call(GetGroupUrdf, "/get_urdf", group_name="arm")
    assert answer.error_code.val == SUCCESS
    assert '<link name="link_6"' in answer.urdf_string
    assert arm.ros.call(GetGroupUrdf, "/get_urdf", group_name="leg").error_code.val == E.INVALID_GROUP_NAME


def test_many_states_are_checked_at_once(arm: Stack, robot: Robot) -> None:
    states = [JointState(name=list(JOINTS), position=[turn, *HOME[1:]]) for turn in np.linspace(-1.0, 1.0, 1500)]
    answer = arm.ros.call(GetMultiStateValidity, "/check_multi_state_validity", group_name="arm", joint_states=states)
    assert answer.valid
    states[700] = JointState(name=list(JOINTS), position=[*HOME[:2], 3.0, *HOME[3:]])
    answer = arm.ros.call(GetMultiStateValidity, "/check_multi_state_validity", group_name="arm", joint_states=states)
    assert not answer.valid


def test_kinematics_of_other_links_and_frames_agree(arm: Stack, robot: Robot) -> None:
    header = Header(frame_id="link_3")
    answer = arm.ros.call(
        GetPositionFK, "/compute_fk", header=header, fk_link_names=["link_5", "link_6"], robot_state=at(HOME)
    )
    assert answer.error_code.val == SUCCESS
    wanted = PositionIKRequest(group_name="arm", robot_state=at([0.1, *HOME[1:]]), avoid_collisions=True)
    wanted.ik_link_name, wanted.pose_stamped = "link_5", answer.pose_stamped[0]
    wanted.pose_stamped.header.frame_id = "link_3"
    found = arm.ros.call(GetPositionIK, "/compute_ik", ik_request=wanted)
    assert found.error_code.val == SUCCESS, found.error_code
    again = arm.ros.call(GetPositionFK, "/compute_fk", fk_link_names=["link_5"], robot_state=found.solution)
    base = arm.ros.call(GetPositionFK, "/compute_fk", fk_link_names=["link_5"], robot_state=at(HOME))
    p, q = again.pose_stamped[0].pose.position, base.pose_stamped[0].pose.position
    assert np.allclose((p.x, p.y, p.z), (q.x, q.y, q.z), atol=2e-3)
    nowhere = arm.ros.call(GetPositionFK, "/compute_fk", fk_link_names=["no_link"], robot_state=at(HOME))
    assert nowhere.error_code.val == E.INVALID_LINK_NAME
