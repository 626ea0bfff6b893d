"""An arm under ros2_control is moved from its URDF alone: the action of the trajectory controller that it names is the driver."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from rclpy.node import Node
from sensor_msgs.msg import JointState

from support.command_line import Up, data, done
from support.harness import PATIENCE, eventually, free_endpoint
from support.paths import PROGRAMS
from support.ros.client import RosClient

START = {"turn": 0.2, "lift": -0.4, "bend": 0.9}
GOAL = {"turn": -0.6, "lift": 0.5, "bend": -0.3}
COMMANDS, STATES = "/cell/arm_controller/joint_trajectory", "/joint_states"


def described(folder: Path) -> Path:
    """An arm of three tubes in a folder with the parameters of its controllers, as a simulator's package has them."""
    links, joints, parent = [], [], "base"
    for name, axis, at, length in (
        ("turn", "0 0 1", 0.06, 0.2),
        ("lift", "0 1 0", 0.25, 0.3),
        ("bend", "0 1 0", 0.35, 0.25),
    ):
        links.append(
            f'<link name="{name}_link"><collision><origin xyz="0 0 {length / 2}"/><geometry><cylinder radius="0.04" '
            f'length="{length}"/></geometry></collision></link>'
        )
        joints.append(
            f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{name}_link"/><origin xyz="0 0 {at}"/>'
            f'<axis xyz="{axis}"/><limit lower="-2" upper="2" velocity="1.5" effort="10"/></joint>'
        )
        parent = f"{name}_link"
    interfaces = "".join(f'<joint name="{name}"><command_interface name="position"/></joint>' for name in START)
    control = (
        f'<ros2_control name="arm" type="system"><hardware><plugin>a/b</plugin></hardware>{interfaces}</ros2_control>'
    )
    plugin = "<plugin><ros><namespace>/cell</namespace></ros><parameters>controllers.yaml</parameters></plugin>"
    (folder / "controllers.yaml").write_text(
        "controller_manager:\n  ros__parameters:\n"
        "    arm_controller: {type: joint_trajectory_controller/JointTrajectoryController}\n"
        f"arm_controller:\n  ros__parameters: {{joints: [{', '.join(START)}]}}\n"
    )
    file = folder / "arm.urdf"
    base = '<link name="base"><collision><geometry><box size="0.12 0.12 0.1"/></geometry></collision></link>'
    file.write_text(f'<robot name="arm">{base}{"".join(links + joints)}{control}<gazebo>{plugin}</gazebo></robot>')
    return file


@contextmanager
def controller() -> Iterator[None]:
    """The stand-in for the arm's ros2_control, on the topics that follow from the URDF."""
    joints = [f"{name}={at}" for name, at in START.items()]
    command = [sys.executable, str(PROGRAMS / "ros_controller.py"), COMMANDS, STATES, *joints]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout.readline() == "ready\n"
        yield
    finally:
        process.terminate()
        process.wait(PATIENCE)
        process.stdout.close()


@pytest.mark.slow
def test_zarm_up_with_a_urdf_moves_through_its_controller(tmp_path: Path, node: Node) -> None:
    ros = RosClient(node)
    robot = ("--robot", str(described(tmp_path)), "--ros", "--strategy", "joint_trajectory")
    with controller(), Up(free_endpoint(), tmp_path, *robot, name="arm", XDG_CACHE_HOME=str(tmp_path / "cache")) as up:
        states = ros.heard(JointState, STATES)
        seen = eventually(lambda: (found := states[-1:]) and found[0], "the controller tells its joints")
        assert dict(zip(seen.name, seen.position, strict=True)) == pytest.approx(START)
        done(up, "plan", "--joints", ",".join(map(str, GOAL.values())))
        assert "succeeded" in json.dumps(data(up, "execute"))

        def arrived() -> bool:
            joints = dict(zip(states[-1].name, states[-1].position, strict=True))
            return bool(list(map(joints.get, GOAL)) == pytest.approx(list(GOAL.values()), abs=1e-3))

        eventually(arrived, "the controller tells the joints of the goal")
