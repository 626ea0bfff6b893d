"""A tool that is mounted while the bridge runs: its tip is what clients of MoveIt plan for, and a frame of the robot."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from pymoveit2 import MoveIt2
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node

import zarm
from support.ros.node import served, spinning
from support.ros.stack import Stack, stack
from support.tools import with_tools
from zarm.robot import Robot
from zarm_contract.robot import RobotDescription, load_robot
from zarm_geometry.frames import pose_of
from zarm_geometry.robot_model import RobotModel
from zarm_ros_bridge.description import shown_description


@pytest.fixture(scope="module")
def described(tmp_path_factory: pytest.TempPathFactory) -> RobotDescription:
    return load_robot(with_tools(tmp_path_factory.mktemp("tools")))


@pytest.fixture(scope="module")
def cell(described: RobotDescription, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    folder = tmp_path_factory.mktemp("stack")
    with stack(folder, robot=str(described.path), ros_bridge=("--moveit",), servo=()) as processes:
        yield processes


@pytest.fixture(scope="module")
def robot(cell: Stack) -> Iterator[Robot]:
    with zarm.connect(cell.endpoint, "arm") as robot:
        yield robot


@pytest.fixture
def client() -> Iterator[Node]:
    with spinning("tool_client") as node:
        yield node


def moveit(client: Node, described: RobotDescription, link: str) -> MoveIt2:
    made = MoveIt2(
        node=client,
        joint_names=list(described.descriptor.joints),
        base_link_name="base_link",
        end_effector_name=link,
        group_name="arm",
        callback_group=ReentrantCallbackGroup(),
    )
    served(client, "move_action", "execute_trajectory")
    return made


def test_moveit_moves_the_link_that_it_names_whatever_is_mounted(
    client: Node, described: RobotDescription, robot: Robot
) -> None:
    model = RobotModel.of(described)
    home = np.array(described.descriptor.home)
    goals = {link: model.fk_link(link, home + 0.1) for link in ("link_6", "welder")}
    assert not np.allclose(goals["link_6"], goals["welder"], atol=0.1)
    for mounted in (None, "welder", "probe"):
        if mounted is not None:
            robot.scene.mount(mounted)
        for link, goal in goals.items():
            robot.execute(robot.plan(described.descriptor.home))
            arm = moveit(client, described, link)
            pose = pose_of(goal)
            arm.move_to_pose(position=pose.position, quat_xyzw=pose.orientation)
            assert arm.wait_until_executed()
            reached = np.array(robot.joint_state().position)
            assert model.fk_link(link, reached)[:3, 3] == pytest.approx(goal[:3, 3], abs=2e-3), (mounted, link)


def test_tip_of_each_tool_is_a_frame_of_the_robot(described: RobotDescription) -> None:
    text = shown_description(described)
    assert '<link name="welder"' in text
    assert '<child link="probe"' in text
