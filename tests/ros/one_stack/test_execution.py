"""Goals of the actions, against real processes: what a client is told, and what the robot does."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Point, Pose, Quaternion
from rcl_interfaces.msg import Log
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_srvs.srv import Trigger

import zarm
from support.harness import PATIENCE, eventually
from support.planner.client import BEHIND_FENCE, FENCE
from support.ros.goals import ABORTED, CANCELED, SUCCEEDED, TARGET, Actions, Robot
from support.ros.node import destroyed
from support.ros.stack import KEYS, Stack
from support.trajectories import HOME
from zarm_contract.errors import ZarmError
from zarm_contract.messages import (
    AddObjects,
    Authority,
    CancelRequest,
    ExecuteRequest,
    LoadScene,
    Obstruction,
    RemoveObjects,
    SceneEdit,
    Sphere,
)


@pytest.fixture
def robot(running: Stack) -> Robot:
    found = Robot(running.bus, KEYS)
    found.wait_rest()
    return found


@pytest.fixture
def actions(running: Stack) -> Actions:
    return Actions(running.ros.node)


@pytest.fixture
def preempting(running: Stack) -> Iterator[None]:
    running.ros.configure(preempt=True)
    yield
    running.ros.configure(preempt=False)


@pytest.fixture
def long_planned(running: Stack, robot: Robot) -> Iterator[list[float]]:
    """Target joints behind a fence, to which the planner looks for a way for a minute; the robot is at home."""
    with zarm.connect(running.endpoint) as client:
        client.execute(client.plan(HOME))
    for objects in (FENCE, ()):
        running.ros.configure(timeout=60.0 if objects else 5.0)
        edit = SceneEdit(edit=LoadScene(op="load", objects=objects))
        robot.bus.call(KEYS.scene_edit, edit, timeout=PATIENCE)
        if objects:
            yield list(BEHIND_FENCE)


def test_an_empty_goal_runs_the_last_plan_with_progress(robot: Robot, actions: Actions) -> None:
    plan = robot.plan()
    goal = actions.send()
    status, result = goal.ended()
    assert (status, result.success, result.message) == (SUCCEEDED, True, "Trajectory executed successfully")
    assert np.allclose(robot.joints(), plan.trajectory.position[-1], atol=1e-3)
    words = list(dict.fromkeys(report.state for report in goal.feedback))
    assert words == ["EXECUTING"]
    shares = [report.step_progression for report in goal.feedback]
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert len([share for share in shares if 0.0 < share < 1.0]) >= 5
    assert all(tuple(report.joint_command.name) == plan.trajectory.joint_names for report in goal.feedback)
    assert np.allclose(goal.feedback[-1].joint_command.position, plan.trajectory.position[-1], atol=1e-3)


@pytest.mark.parametrize("name", ["execute_trajectory", "send_trajectory"])
def test_a_goal_with_a_target_is_planned_and_then_executed(running: Stack, robot: Robot, name: str) -> None:
    robot.plan()
    goal = Actions(running.ros.node, name).send(target_pose=TARGET)
    status, result = goal.ended()
    assert (status, result.message) == (SUCCEEDED, "Trajectory executed successfully")
    assert goal.feedback[0].state == "PLANNING"
    assert goal.feedback[-1].state == "EXECUTING"


def test_a_cancelled_goal_ends_as_canceled_at_rest(robot: Robot, actions: Actions) -> None:
    plan = robot.plan()
    goal = actions.send()
    goal.under_way()
    goal.cancel()
    status, result = goal.ended()
    assert robot.rests()
    assert (status, result.success) == (CANCELED, False)
    assert result.message
    assert goal.feedback[-1].state == "FAILED"
    assert not np.allclose(robot.joints(), plan.trajectory.position[-1], atol=0.05)


def test_a_goal_cancelled_during_planning_ends_as_canceled(
    running: Stack, robot: Robot, actions: Actions, long_planned: list[float]
) -> None:
    for _ in range(4):
        before = robot.joints()
        goal = actions.send(target_joint_positions=long_planned)
        assert goal.accepted
        eventually(lambda goal=goal: goal.feedback, "it is planned")
        goal.cancel()
        status, result = goal.ended()
        assert (status, result.success) == (CANCELED, False)
        assert robot.rests()
        assert "EXECUTING" not in {report.state for report in goal.feedback}
        assert robot.joints() == before


def test_a_goal_cancelled_by_another_client_ends_as_aborted(robot: Robot, actions: Actions) -> None:
    robot.plan()
    goal = actions.send()
    goal.under_way()
    robot.bus.call(KEYS.cancel, CancelRequest(), timeout=10)
    status, result = goal.ended()
    assert (status, result.message) == (ABORTED, "the goal was cancelled by a client")
    assert robot.rests()


def test_a_goal_that_is_refused_says_why_as_on_the_bus(robot: Robot, actions: Actions) -> None:
    robot.plan()
    ball = Sphere(kind="sphere", name="ball", position=(2.0, 2.0, 2.0), radius=0.1)
    edits = (AddObjects(op="add", objects=(ball,)), RemoveObjects(op="remove", names=("ball",)))
    for edit in edits:
        robot.bus.call(KEYS.scene_edit, SceneEdit(edit=edit), timeout=10)
    with pytest.raises(ZarmError, match="plan") as refusal:
        robot.bus.call(KEYS.execute, ExecuteRequest(), timeout=10)
    status, result = actions.send().ended()
    assert (status, result.success, result.message) == (ABORTED, False, str(refusal.value))


def test_a_scene_edit_under_a_goal_is_logged_on_rosout(running: Stack, robot: Robot, actions: Actions) -> None:
    said: list[str] = []
    listener = running.ros.node.create_subscription(Log, "/rosout", lambda log: said.append(log.msg), 100)
    robot.plan()
    goal = actions.send()
    goal.under_way()
    ball = Sphere(kind="sphere", name="ball", position=(2.0, 2.0, 2.0), radius=0.1)
    for edit in (AddObjects(op="add", objects=(ball,)), RemoveObjects(op="remove", names=("ball",))):
        robot.bus.call(KEYS.scene_edit, SceneEdit(edit=edit), timeout=PATIENCE)
    changed = "The scene has changed since the motion "
    eventually(lambda: any(line.startswith(changed) for line in said), "the bridge says so")
    assert goal.ended()[0] == SUCCEEDED
    assert sum(line.startswith(changed) for line in said) == 1
    destroyed(running.ros.node, running.ros.node.destroy_subscription, listener)


@pytest.mark.slow  # as any goal that is refused
def test_a_plan_is_not_run_a_second_time_from_where_it_ended(robot: Robot, actions: Actions) -> None:
    robot.plan()
    assert actions.send().ended()[0] == SUCCEEDED
    before = robot.joints()
    status, result = actions.send().ended()
    assert status == ABORTED
    assert "start" in result.message
    assert robot.joints() == before


def test_a_target_that_cannot_be_is_refused_with_its_field(robot: Robot, actions: Actions) -> None:
    far = Pose(position=Point(x=9.0, y=0.0, z=0.0))
    status, result = actions.send(target_pose=far).ended()
    assert (status, result.success) == (ABORTED, False)
    assert "reach" in result.message
    crooked = Pose(position=TARGET.position, orientation=Quaternion(x=1.0, y=1.0, z=0.0, w=0.0))
    status, result = actions.send(target_pose=crooked).ended()
    assert status == ABORTED
    assert "target_pose.orientation" in result.message
    assert robot.rests()


def test_a_second_goal_is_rejected_with_the_reason_in_the_log(running: Stack, robot: Robot, actions: Actions) -> None:
    lines: list[Log] = []
    kept = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)  # for whoever is found late
    subscription = running.ros.node.create_subscription(Log, "/rosout", lines.append, kept)
    eventually(subscription.get_publisher_count, "somebody logs")
    robot.plan()
    first = actions.send()
    first.under_way()
    assert not Actions(running.ros.node, "send_trajectory").send().accepted
    assert not actions.send(target_pose=TARGET).accepted
    report = eventually(lambda: [line for line in lines if "rejected" in line.msg], "the rejection is in the log")
    assert report[0].name == "unified_planner"
    assert "cancel it first" in report[0].msg
    assert first.ended()[0] == SUCCEEDED


@pytest.mark.slow  # as any goal that is refused
def test_a_goal_beside_one_of_another_client_is_aborted_as_busy(robot: Robot, actions: Actions) -> None:
    robot.plan()
    goal_id = robot.bus.call(KEYS.execute, ExecuteRequest(), timeout=10).goal_id
    status, result = actions.send().ended()
    assert status == ABORTED
    assert goal_id in result.message or "goal" in result.message
    robot.wait_rest()
    assert robot.bus.read(KEYS.goal(goal_id), timeout=10).status == "succeeded"


@pytest.mark.slow  # as in the next
@pytest.mark.usefixtures("preempting")
def test_with_preempt_a_second_goal_replaces_the_first(robot: Robot, actions: Actions) -> None:
    robot.plan()
    first = actions.send()
    first.under_way()
    second = actions.send(target_pose=TARGET)
    status, result = first.ended()
    assert status == ABORTED
    assert "another goal" in result.message
    assert second.ended()[0] == SUCCEEDED


@pytest.mark.usefixtures("preempting")
def test_a_preempting_goal_replaces_another_client_s_motion(robot: Robot, actions: Actions) -> None:
    robot.plan()
    goal_id = robot.bus.call(KEYS.execute, ExecuteRequest(), timeout=10).goal_id
    assert actions.send(target_pose=TARGET).ended()[0] == SUCCEEDED
    assert robot.bus.read(KEYS.goal(goal_id), timeout=10).status == "cancelled"


@pytest.mark.slow
def test_fifty_goals_at_once_are_answered_and_one_runs(robot: Robot, actions: Actions) -> None:
    robot.plan()
    goals = [actions.send() for _ in range(50)]
    statuses = [goal.ended()[0] for goal in goals if goal.accepted]
    assert statuses.count(SUCCEEDED) == 1
    assert set(statuses) <= {SUCCEEDED, ABORTED}
    robot.plan()
    assert actions.send().ended()[0] == SUCCEEDED


def test_what_a_goal_waits_for_is_on_diagnostics(running: Stack, robot: Robot, actions: Actions) -> None:
    report: list[DiagnosticStatus] = []
    node = running.ros.node
    subscription = node.create_subscription(DiagnosticArray, "/diagnostics", lambda new: report.extend(new.status), 10)
    try:
        eventually(
            lambda: [one for one in report if one.level == DiagnosticStatus.OK], "a robot at rest is said to be well"
        )
        plan = robot.plan(speed=0.15)
        goal = actions.send()
        goal.under_way()
        eventually(lambda: [one for one in report if "no servo watches" in one.message], "it is said to be unguarded")
        servo = robot.bus.publisher(KEYS.authority)
        in_the_way = Authority(
            servo="test",
            sequence=1,
            goal_id=robot.state().goal_id,
            scene_revision=plan.scene_revision,
            until=0.7 * plan.trajectory.duration,
            obstruction=Obstruction(object="box", link="link_4", time=0.8 * plan.trajectory.duration),
        )
        servo.put(in_the_way)
        held = eventually(lambda: [one for one in report if "waits" in one.message], "it is said to wait")[-1]
        assert (held.name, held.level) == ("arm: motion", DiagnosticStatus.WARN)
        assert held.message == "the goal waits: box is in the way of link_4"
        assert {one.key: one.value for one in held.values}["object"] == "box"
        assert running.ros.call(Trigger, "get_robot_strategy").message.endswith(held.message)
        servo.put(in_the_way.model_copy(update={"sequence": 2, "until": None, "obstruction": None}))
        assert goal.ended()[0] == SUCCEEDED
    finally:
        destroyed(node, node.destroy_subscription, subscription)
