"""The names of a robot other than the default one, in both versions."""

from __future__ import annotations

from pathlib import Path

import pytest
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from std_srvs.srv import Trigger

from curobo_msgs.srv import SetRobotStrategy
from support.harness import eventually
from support.ros.client import RosClient, robot_type
from support.ros.node import answer, running_node
from support.ros.stack import controller, stack
from zarm_contract.robot import load_robot


@pytest.mark.slow
def test_the_type_of_a_ur5e_is_its_own_name_in_both_versions(tmp_path: Path) -> None:
    with stack(tmp_path, robot="ur5e") as ur5e, running_node("client_v1") as node:
        first = RosClient(node)
        assert robot_type(node) == "emulator"
        refused = answer(
            AsyncParameterClient(node, "/unified_planner").set_parameters(
                [Parameter("robot_type", value="doosan_m1013")]
            ),
            "it is refused",
        ).results[0]
        assert not refused.successful
        assert "emulator, ghost, ur5e, joint_speed, joint_pose" in refused.reason

        assert robot_type(node, "ur5e") == "ur5e"
        without_controller = first.call(Trigger, "set_robot_strategy")
        assert not without_controller.success
        assert robot_type(node) == "emulator"

        with controller(load_robot("ur5e")):

            def moved() -> bool:
                robot_type(node, "ur5e")
                answered = first.call(Trigger, "set_robot_strategy")
                return answered.success and answered.message == "Strategy switched from 'emulator' to 'ur5e'"

            eventually(moved, "the controller is heard, and the robot is what moves")
            report = ur5e.ros.call(Trigger, "get_robot_strategy").message
            assert report == "joint_trajectory"
            second = ur5e.ros.call(SetRobotStrategy, "set_robot_strategy", robot_strategy="emulator")
            assert second.message == "Strategy switched from 'joint_trajectory' to 'emulator'"
            eventually(lambda: robot_type(node) == "emulator", "robot_type follows")
