"""The driver of an arm on ROS is the trajectory controller that its URDF names."""

from __future__ import annotations

from pathlib import Path

import pytest

from zarm_contract.errors import InvalidRequest
from zarm_robot_import.description import describe
from zarm_robot_import.ros_control import trajectory_controller
from zarm_robot_import.source import read_source

INTERFACE = '<joint name="{}"><command_interface name="position"/></joint>'
PLUGIN = (
    "<gazebo><plugin><ros><namespace>/cell</namespace></ros><parameters>controllers.yaml</parameters></plugin></gazebo>"
)
CONTROLLERS = """
controller_manager:
  ros__parameters:
    update_rate: 500
    gripper_controller: {type: joint_trajectory_controller/JointTrajectoryController}
    arm_controller: {type: joint_trajectory_controller/JointTrajectoryController}
gripper_controller:
  ros__parameters: {joints: [finger]}
arm_controller:
  ros__parameters: {joints: [two, one]}
"""


def controller(folder: Path, *parts: str, system: str = "", joints: str = "one two") -> str | None:
    interfaces = "".join(map(INTERFACE.format, joints.split()))
    file = folder / "arm.urdf"
    file.write_text(
        f'<robot name="arm"><link name="a"/><ros2_control name="arm" type="system">{system}{interfaces}</ros2_control>'
        f"{''.join(parts)}</robot>"
    )
    return trajectory_controller(describe(read_source(file)), ["one", "two"])


def test_a_parameter_of_the_hardware_names_it(tmp_path: Path) -> None:
    system = '<hardware><plugin>x/y</plugin><param name="controller">joint_trajectory_controller</param></hardware>'
    assert controller(tmp_path, system=system) == "joint_trajectory_controller"


def test_simulator_parameters_name_the_arm_s_controller(tmp_path: Path) -> None:
    (tmp_path / "controllers.yaml").write_text(CONTROLLERS)
    assert controller(tmp_path, PLUGIN) == "cell/arm_controller"


def test_there_is_no_controller_without_a_name_or_for_others(tmp_path: Path) -> None:
    assert controller(tmp_path) is None
    (tmp_path / "controllers.yaml").write_text(CONTROLLERS)
    assert controller(tmp_path, PLUGIN, joints="one") is None


def test_parameters_that_are_no_yaml_are_refused_with_the_place(tmp_path: Path) -> None:
    (tmp_path / "controllers.yaml").write_text("a: [")
    with pytest.raises(InvalidRequest, match=r"arm\.urdf:1: .*controllers\.yaml:2: .*not valid YAML"):
        controller(tmp_path, PLUGIN)
