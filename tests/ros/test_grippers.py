"""Grippers on ROS: served as a controller of ros2_control serves them, and driven through such a controller."""

from __future__ import annotations

import shutil
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from control_msgs.action import GripperCommand, ParallelGripperCommand
from moveit_msgs.srv import GetMotionPlan
from pymoveit2 import GripperInterface, MoveIt2Gripper
from rclpy.action import ActionClient, ActionServer, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from sensor_msgs.msg import JointState

import zarm
from support.harness import PATIENCE, ServiceProcess, eventually, router
from support.ros.node import destroyed, served, spinning
from support.ros.stack import KEYS, Stack, stack
from zarm_contract.robot import ROBOTS, load_robot
from zarm_ros_bridge.moveit.srdf import semantic_description
from zarm_runtime.bus import Bus

PANDA = load_robot("panda")
FINGERS = ("panda_finger_joint1", "panda_finger_joint2")
ACTION = "gripper_action_controller/gripper_cmd"


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """An emulated Panda, whose bridge serves MoveIt's interface too."""
    with stack(tmp_path_factory.mktemp("panda"), robot="panda", ros_bridge=("--moveit",)) as processes:
        yield processes


def sent(node: Node, position: float, max_effort: float = 0.0) -> tuple[Any, list[Any]]:
    """The response to a goal of the action, and its feedback."""
    goal = GripperCommand.Goal()
    goal.command.position, goal.command.max_effort = position, max_effort
    return sent_goal(node, GripperCommand, ACTION, goal)


def sent_goal(node: Node, kind: Any, action: str, goal: Any) -> tuple[Any, list[Any]]:
    """The response to a goal of an action, and its feedback."""
    client, feedback = ActionClient(node, kind, action), list[Any]()
    try:
        assert client.wait_for_server(PATIENCE)
        future = client.send_goal_async(goal, feedback_callback=lambda message: feedback.append(message.feedback))
        eventually(future.done, "the goal is answered")
        result = future.result().get_result_async()
        eventually(result.done, "the goal ends")
        return result.result(), feedback
    finally:
        destroyed(node, ActionClient.destroy, client)


def test_a_gripper_command_moves_the_fingers_and_reports(arm: Stack, node: Node) -> None:
    response, feedback = sent(node, 0.01, 20.0)
    assert response.result.reached_goal
    assert not response.result.stalled
    assert response.result.position == pytest.approx(0.01, abs=5e-4)
    assert len({message.position for message in feedback}) > 3
    response, _ = sent(node, 0.04)
    assert response.result.position == pytest.approx(0.04, abs=5e-4)


@pytest.mark.parametrize("position", [0.2, float("nan")])
def test_a_position_out_of_range_is_refused_and_nothing_moves(arm: Stack, node: Node, position: float) -> None:
    sent(node, 0.04)
    response, _ = sent(node, position)
    assert not response.result.reached_goal
    assert response.result.position == pytest.approx(0.04, abs=5e-4)


def test_the_newer_gripper_action_moves_the_fingers_too(arm: Stack, node: Node) -> None:
    def parallel(**command: Any) -> tuple[Any, list[Any]]:
        goal = ParallelGripperCommand.Goal(command=JointState(**command))
        return sent_goal(node, ParallelGripperCommand, f"parallel_{ACTION}", goal)

    sent(node, 0.04)
    response, feedback = parallel(name=[FINGERS[0]], position=[0.01], velocity=[0.02], effort=[20.0])
    assert response.result.reached_goal
    assert response.result.state.name == [FINGERS[0]]
    assert response.result.state.position[0] == pytest.approx(0.01, abs=5e-4)
    assert len({message.state.position[0] for message in feedback}) > 3
    response, _ = parallel(position=[0.03])
    assert response.result.state.position[0] == pytest.approx(0.03, abs=5e-4)
    for bad in ({"name": ["thumb"], "position": [0.0]}, {}, {"position": [0.0], "velocity": [-1.0]}):
        response, _ = parallel(**bad)
        assert not response.result.reached_goal
        assert response.result.state.position[0] == pytest.approx(0.03, abs=5e-4)


def test_fingers_are_among_the_joint_states(arm: Stack, node: Node) -> None:
    states: list[JointState] = []
    subscription = node.create_subscription(JointState, "joint_states", states.append, 10)
    sent(node, 0.02)
    state = eventually(
        lambda: next(
            (one for one in states if abs(dict(zip(one.name, one.position, strict=True))[FINGERS[1]] - 0.02) < 5e-4),
            None,
        ),
        "the fingers are reported",
    )
    assert list(state.name) == [*PANDA.descriptor.joints, *FINGERS]
    destroyed(node, node.destroy_subscription, subscription)


def test_the_client_of_moveit_opens_and_closes(arm: Stack, node: Node) -> None:
    gripper = GripperInterface(
        node=node,
        gripper_joint_names=list(FINGERS),
        open_gripper_joint_positions=[0.04, 0.04],
        closed_gripper_joint_positions=[0.0, 0.0],
        gripper_group_name="hand",
        gripper_command_action_name=ACTION,
    )
    served(node, ACTION, "move_action")
    with zarm.connect(arm.endpoint, "arm") as robot:
        for act, width in ((gripper.close, 0.0), (gripper.open, 0.08)):
            act()
            eventually(lambda width=width: abs((robot.gripper.state().width or 0.0) - width) < 2e-3, f"{width} m")


@pytest.mark.parametrize("whole", [True, False], ids=["move_action", "plan and execute"])
def test_the_group_of_a_gripper_is_planned_and_executed(arm: Stack, whole: bool) -> None:
    with spinning("hand_client") as client, zarm.connect(arm.endpoint, "arm") as robot:
        hand = MoveIt2Gripper(
            node=client,
            gripper_joint_names=list(FINGERS),
            open_gripper_joint_positions=[0.04, 0.04],
            closed_gripper_joint_positions=[0.0, 0.0],
            gripper_group_name="hand",
            use_move_group_action=whole,
            callback_group=ReentrantCallbackGroup(),
        )
        served(client, "move_action", "execute_trajectory")
        assert client.create_client(GetMotionPlan, "plan_kinematic_path").wait_for_service(PATIENCE)
        for act, width in ((hand.close, 0.0), (hand.open, 0.08)):
            act()
            assert hand.wait_until_executed(PATIENCE)
            assert robot.gripper.state().width == pytest.approx(width, abs=1e-3)


def test_the_semantic_description_has_the_group_of_the_gripper() -> None:
    root = ET.fromstring(semantic_description(PANDA, "arm"))
    (group,) = (one for one in root.findall("group") if one.get("name") == "hand")
    assert [joint.get("name") for joint in group] == list(FINGERS)
    states = {
        one.get("name"): [float(joint.get("value", "nan")) for joint in one]
        for one in root.findall("group_state")
        if one.get("group") == "hand"
    }
    assert states == {"open": [0.04, 0.04], "close": [0.0, 0.0]}
    effector = root.find("end_effector")
    assert effector is not None
    assert (effector.get("parent_link"), effector.get("parent_group")) == ("panda_hand", "arm")


@contextmanager
def controller(node: Node, kind: Any, finger: list[float], end: str) -> Iterator[None]:
    """A gripper's controller, and a robot that stands at home; a goal ends as `end` says."""

    def carry_out(goal: Any) -> Any:
        result, wanted = kind.Result(), goal.request.command.position
        if end != "aborted":  # the finger stays where it is
            finger[0] = 0.015 if end == "stalled" else wanted if kind is GripperCommand else wanted[0]
        result.stalled, result.reached_goal = end == "stalled", end == "reached"
        if kind is GripperCommand:
            result.position = finger[0]
        else:
            result.state = JointState(name=[FINGERS[0]], position=[finger[0]])
        (goal.abort if end == "aborted" else goal.succeed)()
        return result

    admission = GoalResponse.REJECT if end == "rejected" else GoalResponse.ACCEPT
    server = ActionServer(node, kind, "/hand_controller/gripper_cmd", carry_out, goal_callback=lambda _: admission)
    states = node.create_publisher(JointState, "/panda/joint_states", 10)
    names = [*PANDA.descriptor.joints, FINGERS[0]]

    def report() -> None:
        message = JointState(name=names, position=[*PANDA.descriptor.home, finger[0]], velocity=[0.0] * len(names))
        message.header.stamp = node.get_clock().now().to_msg()
        states.publish(message)

    timer = node.create_timer(0.01, report)
    try:
        yield
    finally:
        destroyed(node, node.destroy_timer, timer)
        destroyed(node, node.destroy_publisher, states)
        destroyed(node, ActionServer.destroy, server)


@pytest.fixture
def driven(tmp_path: Path) -> Path:
    """A Panda whose arm and hand are under ros2_control."""
    for suffix in (".yaml", ".urdf"):
        shutil.copy(ROBOTS / f"panda{suffix}", tmp_path)
    path = tmp_path / "panda.yaml"
    text = path.read_text().replace("strategy: emulator\n", "strategy: joint_trajectory\n")
    for line in ("  action: /panda_arm_controller/follow_joint_trajectory\n", "  strategies: [joint_trajectory]\n"):
        assert line in text
        text = text.replace(line, "")
    text = text.replace("joint_states_topic: /franka/joint_states", "joint_states_topic: /panda/joint_states")
    path.write_text(text.replace("  force: 70.0", "  force: 70.0\n    action: /hand_controller/gripper_cmd"))
    return path


@pytest.mark.parametrize(
    ("kind", "end"),
    [
        *((GripperCommand, end) for end in ("reached", "stalled", "aborted", "rejected")),
        *((ParallelGripperCommand, end) for end in ("reached", "stalled")),
    ],
)
def test_a_real_gripper_ends_as_its_controller_says(
    node: Node, driven: Path, tmp_path: Path, kind: Any, end: str
) -> None:
    finger = [0.04]
    if kind is ParallelGripperCommand:
        parallel = "gripper_cmd\n    action_type: control_msgs/action/ParallelGripperCommand"
        driven.write_text(driven.read_text().replace("gripper_cmd", parallel))
    with router() as endpoint, Bus(endpoint) as bus, controller(node, kind, finger, end):
        bridge = ServiceProcess("ros_bridge", endpoint, tmp_path, str(driven), name="arm")
        executor = ServiceProcess("executor", endpoint, tmp_path, str(driven), name="arm")
        with bridge, executor, zarm.connect(endpoint, "arm") as robot:
            bridge.wait_ready(bus, KEYS)
            executor.wait_ready(bus, KEYS)
            eventually(lambda: robot.gripper.state().position == pytest.approx(0.04), "the finger is reported")
            if end in ("reached", "stalled"):
                last = robot.gripper.close()
                assert (last.status, last.width) == (end, pytest.approx(2 * finger[0], abs=1e-6))
            else:
                with pytest.raises(zarm.ExecutionFailed, match="/hand_controller/gripper_cmd"):
                    robot.gripper.close()
