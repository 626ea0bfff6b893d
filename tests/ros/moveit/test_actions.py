"""The actions of move_group: what is executed, what is refused, and what the codes say."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from moveit_msgs.action import ExecuteTrajectory, MoveGroup, MoveGroupSequence
from moveit_msgs.msg import DisplayTrajectory, MotionSequenceItem, MoveItErrorCodes, PlanningOptions
from rclpy.action import ActionClient

import zarm
from support.harness import PATIENCE, eventually
from support.ros.goals import ABORTED, SUCCEEDED, Sent
from support.ros.moveit import joints, planned, pose, request
from support.ros.stack import KEYS, Stack
from zarm.connection import Connection
from zarm.robot import Robot
from zarm_contract.robot import load_robot

ROBOT = load_robot("doosan_m1013")
JOINTS, HOME = ROBOT.descriptor.joints, ROBOT.descriptor.home
AT = (0.5, 0.2, 0.6)
E = MoveItErrorCodes


@pytest.fixture
def robot(arm: Stack) -> Iterator[Robot]:
    """The robot at home and at full speed, in an empty scene; both are so again afterwards."""
    robot = Robot(Connection.of(arm.bus, KEYS))
    robot.scene.clear()
    robot.execute(robot.plan(HOME))
    yield robot
    robot.executor.speed(1.0)
    robot.scene.clear()


def sent(arm: Stack, kind: Any, name: str, goal: Any) -> Sent:
    client = ActionClient(arm.ros.node, kind, name)
    assert client.wait_for_server(PATIENCE)
    made = Sent(arm.ros.node, client, goal)
    assert made.accepted
    return made


def moved(arm: Stack, wanted: Any, **options: Any) -> Sent:
    return sent(
        arm, MoveGroup, "/move_action", MoveGroup.Goal(request=wanted, planning_options=PlanningOptions(**options))
    )


def executed(arm: Stack, trajectory: Any) -> Any:
    return sent(arm, ExecuteTrajectory, "/execute_trajectory", ExecuteTrajectory.Goal(trajectory=trajectory)).ended()[1]


def test_a_goal_that_only_plans_moves_nothing_and_is_shown(arm: Stack, robot: Robot) -> None:
    shown = arm.ros.heard(DisplayTrajectory, "/display_planned_path")
    status, result = moved(arm, request(pose(AT)), plan_only=True).ended()
    assert (status, result.error_code.val) == (SUCCEEDED, E.SUCCESS)
    points = result.planned_trajectory.joint_trajectory.points
    assert list(points[0].positions) == pytest.approx(HOME)
    assert not result.executed_trajectory.joint_trajectory.points
    assert robot.joint_state().position == pytest.approx(HOME)
    eventually(
        lambda: any(len(one.trajectory[0].joint_trajectory.points) == len(points) for one in shown), "it is shown"
    )


def test_a_goal_moves_the_robot_and_reports_its_states(arm: Stack, robot: Robot) -> None:
    goal = moved(arm, request(pose(AT)))
    status, result = goal.ended()
    assert (status, result.error_code.val) == (SUCCEEDED, E.SUCCESS)
    assert np.allclose(robot.tip().position, AT, atol=1e-3)
    assert [one.state for one in goal.feedback][-2:] == ["MONITOR", "IDLE"]
    made = result.executed_trajectory.joint_trajectory
    assert list(made.joint_names) == list(JOINTS)
    assert len(made.points) > 10
    assert list(made.points[0].positions) == pytest.approx(HOME, abs=0.01)
    assert list(made.points[-1].positions) == pytest.approx(robot.joint_state().position, abs=0.01)
    times = [point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec for point in made.points]
    assert all(later > earlier for earlier, later in itertools.pairwise(times))


def test_a_plan_is_refused_once_the_scene_has_changed(arm: Stack, robot: Robot) -> None:
    trajectory = planned(arm.ros, request(pose(AT))).trajectory
    robot.scene.add(zarm.Sphere("far", radius=0.05, position=(2.0, 2.0, 2.0)))
    result = executed(arm, trajectory)
    assert result.error_code.val == E.MOTION_PLAN_INVALIDATED_BY_ENVIRONMENT_CHANGE
    assert robot.joint_state().position == pytest.approx(HOME)


def test_a_trajectory_changed_by_a_client_is_checked(arm: Stack, robot: Robot) -> None:
    trajectory = planned(arm.ros, request(joints(JOINTS[:1], [HOME[0] + 0.3]))).trajectory
    points = trajectory.joint_trajectory.points
    for point in points:
        point.time_from_start.sec, point.time_from_start.nanosec = divmod(
            2 * (point.time_from_start.sec * 10**9 + point.time_from_start.nanosec), 10**9
        )
        point.velocities = [value / 2 for value in point.velocities]
        point.accelerations = [value / 4 for value in point.accelerations]
    assert executed(arm, trajectory).error_code.val == E.SUCCESS
    assert robot.joint_state().position[0] == pytest.approx(HOME[0] + 0.3, abs=1e-3)
    result = executed(arm, trajectory)  # from where the robot is no longer
    assert result.error_code.val == E.CONTROL_FAILED
    assert "start" in result.error_code.message


def test_a_sequence_is_executed_as_one_motion(arm: Stack, robot: Robot) -> None:
    goal = MoveGroupSequence.Goal()
    corners = [AT, (AT[0], AT[1] - 0.15, AT[2]), (AT[0] - 0.1, AT[1] - 0.15, AT[2])]
    goal.request.items = [
        MotionSequenceItem(req=request(pose(corner), planner_id=planner), blend_radius=radius)
        for corner, planner, radius in zip(corners, ("PTP", "LIN", "LIN"), (0.0, 0.03, 0.0), strict=True)
    ]
    status, result = sent(arm, MoveGroupSequence, "/sequence_move_group", goal).ended()
    assert (status, result.response.error_code.val) == (SUCCEEDED, E.SUCCESS), result.response.error_code
    assert np.allclose(robot.tip().position, corners[-1], atol=1e-3)


def test_a_second_goal_is_refused_while_the_robot_moves(arm: Stack, robot: Robot) -> None:
    robot.executor.speed(0.2)
    first = moved(arm, request(joints(JOINTS[:1], [HOME[0] + 0.5])))
    eventually(lambda: robot.state().goal_id is not None, "it moves")
    status, result = moved(arm, request(joints(JOINTS, HOME))).ended()
    assert (status, result.error_code.val) == (ABORTED, E.CONTROL_FAILED)
    assert moved(arm, request(joints(JOINTS, HOME)), plan_only=True).ended()[1].error_code.val == E.SUCCESS
    robot.executor.speed(1.0)
    assert first.ended()[1].error_code.val == E.SUCCESS


def test_a_scene_of_one_plan_is_refused(arm: Stack, robot: Robot) -> None:
    options = PlanningOptions(plan_only=True)
    options.planning_scene_diff.allowed_collision_matrix.entry_names = ["link_5"]
    goal = MoveGroup.Goal(request=request(pose(AT)), planning_options=options)
    result = sent(arm, MoveGroup, "/move_action", goal).ended()[1]
    assert "apply_planning_scene" in result.error_code.message
