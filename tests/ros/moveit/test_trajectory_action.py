"""The robot as a controller of ros2_control: a program that plans elsewhere executes through zarm."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence

import numpy as np
import pytest
from builtin_interfaces.msg import Duration, Time
from control_msgs.action import FollowJointTrajectory
from control_msgs.msg import JointTolerance, JointTrajectoryControllerState
from rclpy.action import ActionClient
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from support.harness import PATIENCE, eventually
from support.ros.goals import ABORTED, CANCELED, SUCCEEDED, Sent
from support.ros.node import destroyed
from support.ros.stack import KEYS, Stack
from zarm.connection import Connection
from zarm.robot import Robot
from zarm_contract.robot import load_robot

ROBOT = load_robot("doosan_m1013")
JOINTS, HOME = ROBOT.descriptor.joints, ROBOT.descriptor.home
THERE = [HOME[0] + 0.4, *HOME[1:]]
R = FollowJointTrajectory.Result


@pytest.fixture
def robot(arm: Stack) -> Robot:
    """The robot at home, in an empty scene."""
    robot = Robot(Connection.of(arm.bus, KEYS))
    robot.scene.clear()
    robot.execute(robot.plan(HOME))
    return robot


@pytest.fixture
def controller(arm: Stack, robot: Robot) -> Iterator[ActionClient]:
    client = ActionClient(arm.ros.node, FollowJointTrajectory, "/zarm_controller/follow_joint_trajectory")
    assert client.wait_for_server(PATIENCE)
    yield client
    destroyed(arm.ros.node, ActionClient.destroy, client)


def goal(*points: tuple[float, Sequence[float]], names: Sequence[str] = JOINTS, **fields: object) -> object:
    made = [
        JointTrajectoryPoint(
            positions=list(map(float, at)),
            time_from_start=Duration(sec=int(time), nanosec=round(time % 1 * 1e9)),
        )
        for time, at in points
    ]
    return FollowJointTrajectory.Goal(trajectory=JointTrajectory(joint_names=list(names), points=made), **fields)


def test_a_trajectory_of_positions_is_executed(arm: Stack, controller: ActionClient, robot: Robot) -> None:
    sent = Sent(arm.ros.node, controller, goal((1.0, np.add(HOME, THERE) / 2), (2.0, THERE)))
    assert sent.accepted
    status, result = sent.ended()
    assert (status, result.error_code) == (SUCCEEDED, R.SUCCESSFUL), result.error_string
    assert np.allclose(robot.joint_state().position, THERE, atol=1e-3)
    assert sent.feedback
    assert list(sent.feedback[-1].joint_names) == list(JOINTS)


def test_joints_may_come_in_any_order(arm: Stack, controller: ActionClient, robot: Robot) -> None:
    names = list(reversed(JOINTS))
    sent = Sent(arm.ros.node, controller, goal((2.0, list(reversed(THERE))), names=names))
    assert sent.accepted
    assert sent.ended()[1].error_code == R.SUCCESSFUL
    assert np.allclose(robot.joint_state().position, THERE, atol=1e-3)


def test_a_new_goal_takes_the_place_of_the_one_that_runs(arm: Stack, controller: ActionClient, robot: Robot) -> None:
    first = Sent(arm.ros.node, controller, goal((20.0, THERE)))
    assert first.accepted
    eventually(lambda: first.feedback, "it moves")
    second = Sent(arm.ros.node, controller, goal((3.0, HOME)))
    assert second.accepted
    assert first.ended()[0] == ABORTED
    assert second.ended()[1].error_code == R.SUCCESSFUL
    assert np.allclose(robot.joint_state().position, HOME, atol=1e-3)


def test_a_goal_is_cancelled(arm: Stack, controller: ActionClient, robot: Robot) -> None:
    sent = Sent(arm.ros.node, controller, goal((20.0, THERE)))
    assert sent.accepted
    eventually(lambda: sent.feedback, "it moves")
    sent.handle.cancel_goal_async()
    assert sent.ended()[0] == CANCELED
    eventually(lambda: robot.state().goal_id is None, "the robot rests")


@pytest.mark.parametrize(
    ("made", "code", "said"),
    [
        (goal((2.0, THERE[:5]), names=JOINTS[:5]), R.INVALID_JOINTS, "joint_6"),
        (goal((2.0, THERE), names=[*JOINTS[:5], "other"]), R.INVALID_JOINTS, "joint_6"),
        (goal((2.0, THERE), (1.0, HOME)), R.INVALID_GOAL, "time_from_start"),
        (goal((0.0, THERE)), R.INVALID_GOAL, "only point"),
        (goal((2.0, [float("nan"), *HOME[1:]])), R.INVALID_GOAL, "finite"),
        (goal((0.05, THERE)), R.INVALID_GOAL, "limit"),
        (goal((2.0, [9.0, *HOME[1:]])), R.INVALID_GOAL, "joint_1"),
    ],
    ids=["too few", "unknown", "backwards", "at once", "nan", "too fast", "out of range"],
)
def test_what_the_robot_cannot_do_is_refused(
    arm: Stack, controller: ActionClient, robot: Robot, made: object, code: int, said: str
) -> None:
    sent = Sent(arm.ros.node, controller, made)
    assert sent.accepted
    status, result = sent.ended()
    assert (status, result.error_code) == (ABORTED, code), result.error_string
    assert said in result.error_string
    assert np.allclose(robot.joint_state().position, HOME, atol=1e-3)


def test_a_trajectory_that_is_over_is_refused(arm: Stack, controller: ActionClient, robot: Robot) -> None:
    made = goal((2.0, THERE))
    made.trajectory.header.stamp.sec = 1
    sent = Sent(arm.ros.node, controller, made)
    assert sent.accepted
    assert sent.ended()[1].error_code == R.OLD_HEADER_TIMESTAMP


def test_a_goal_tolerance_is_checked_at_the_end(arm: Stack, controller: ActionClient, robot: Robot) -> None:
    tolerance = JointTolerance(name="joint_1", position=0.5)
    sent = Sent(arm.ros.node, controller, goal((2.0, THERE), goal_tolerance=[tolerance]))
    assert sent.accepted
    assert sent.ended()[1].error_code == R.SUCCESSFUL


def test_goals_own_tolerances_stop_the_robot_on_its_way(arm: Stack, controller: ActionClient, robot: Robot) -> None:
    robot.speed(0.3)
    try:
        late = Sent(arm.ros.node, controller, goal((2.0, THERE), goal_time_tolerance=Duration(nanosec=200_000_000)))
        status, result = late.ended()
        assert (status, result.error_code) == (ABORTED, R.GOAL_TOLERANCE_VIOLATED), result.error_string
        assert "more than 0.2 s late" in result.error_string
        assert abs(robot.joint_state().position[0] - THERE[0]) > 0.05, "it stopped on its way"
        assert robot.state().mode == "idle"
    finally:
        robot.speed(1.0)


def test_leaving_the_path_tolerance_stops_the_robot(arm: Stack, controller: ActionClient, robot: Robot) -> None:
    tolerances = [JointTolerance(name="joint_1", position=1e-7)]
    sent = Sent(arm.ros.node, controller, goal((2.0, THERE), path_tolerance=tolerances))
    status, result = sent.ended()
    assert (status, result.error_code) == (ABORTED, R.PATH_TOLERANCE_VIOLATED), result.error_string
    assert "joint_1 is" in result.error_string
    unbound = [JointTolerance(name="joint_1", position=-1.0)]
    sent = Sent(arm.ros.node, controller, goal((2.0, THERE), path_tolerance=unbound))
    assert sent.ended()[1].error_code == R.SUCCESSFUL


def test_tolerance_of_an_unknown_joint_is_refused_by_name(arm: Stack, controller: ActionClient, robot: Robot) -> None:
    for field in ("path_tolerance", "goal_tolerance"):
        tolerances = {field: [JointTolerance(name="joint_9", position=0.1)]}
        sent = Sent(arm.ros.node, controller, goal((2.0, THERE), **tolerances))
        status, result = sent.ended()
        assert (status, result.error_code) == (ABORTED, R.INVALID_JOINTS)
        assert "'joint_9' is not a joint of the trajectory" in result.error_string
    assert np.allclose(robot.joint_state().position, HOME, atol=1e-3)


def test_a_trajectory_on_the_topic_begins_at_its_stamp(arm: Stack, robot: Robot) -> None:
    node, begun = arm.ros.node, list[float]()
    publisher = node.create_publisher(JointTrajectory, "/zarm_controller/joint_trajectory", 1)
    arm.bus.subscribe(
        KEYS.executor_state, lambda _, state: begun.append(time.time()) if state.mode == "running" else None
    )
    try:
        eventually(publisher.get_subscription_count, "the controller is there")
        withdrawn, wanted = goal((2.0, [HOME[0] - 0.4, *HOME[1:]])).trajectory, goal((2.0, THERE)).trajectory  # type: ignore[attr-defined]
        for made, later in ((withdrawn, 0.6), (wanted, 1.2)):
            stamp = time.time() + later
            made.header.stamp = Time(sec=int(stamp), nanosec=int(stamp % 1 * 1e9))
            publisher.publish(made)
        eventually(lambda: np.allclose(robot.joint_state().position, THERE, atol=1e-3), "the robot is there")
        eventually(lambda: robot.state().mode == "idle", "it stands")
        assert begun[0] >= stamp
    finally:
        destroyed(node, node.destroy_publisher, publisher)


def test_controller_topics_move_the_robot_and_report_state(arm: Stack, robot: Robot) -> None:
    node, states = arm.ros.node, list[JointTrajectoryControllerState]()
    subscription = node.create_subscription(
        JointTrajectoryControllerState, "/zarm_controller/controller_state", states.append, 10
    )
    publisher = node.create_publisher(JointTrajectory, "/zarm_controller/joint_trajectory", 1)
    try:
        eventually(lambda: states and publisher.get_subscription_count(), "the controller is there")
        assert list(states[-1].joint_names) == list(JOINTS)
        assert np.allclose(states[-1].feedback.positions, HOME, atol=1e-3)
        publisher.publish(goal((2.0, THERE)).trajectory)  # type: ignore[attr-defined]
        eventually(lambda: np.allclose(states[-1].feedback.positions, THERE, atol=1e-3), "the robot is there")
        moving = [one for one in states if 0.05 < one.reference.positions[0] - HOME[0] < 0.35]
        assert moving
        assert all(abs(one.error.positions[0]) < 0.1 for one in moving)
        publisher.publish(goal((4.0, HOME)).trajectory)  # type: ignore[attr-defined]
        eventually(lambda: states[-1].feedback.positions[0] < THERE[0] - 0.05, "it goes back")
        publisher.publish(JointTrajectory())
        eventually(lambda: robot.state().mode == "idle", "it stands")
        assert robot.joint_state().position[0] > HOME[0] + 0.02, "it stopped on its way"
    finally:
        destroyed(node, node.destroy_subscription, subscription)
        destroyed(node, node.destroy_publisher, publisher)
