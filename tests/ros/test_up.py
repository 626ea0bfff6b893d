"""`zarm up --ros`, and a bridge that joins by itself."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from rclpy.node import Node
from std_srvs.srv import Trigger

from support.command_line import KEYS, ROBOT, Up, environment, health, pid, wait_replaced, zarm
from support.harness import PATIENCE, ServiceProcess, eventually, free_endpoint
from support.ros.stack import RosClient
from zarm_runtime.bus import Bus


@pytest.fixture(scope="module")
def up(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Up]:
    with Up(free_endpoint(), tmp_path_factory.mktemp("up"), "--ros") as started:
        yield started


@pytest.mark.slow  # as a driver is started, in access/test_stack.py
def test_up_starts_the_bridge_and_status_shows_it(up: Up, node: Node) -> None:
    answered = RosClient(node).call(Trigger, "get_robot_strategy")
    assert (answered.success, answered.message) == (True, "emulator")
    status = zarm("status", "--json", ZARM_CONNECT=up.endpoint)
    assert json.loads(status.stdout)["services"]["ros_bridge"]["ready"]


@pytest.mark.slow  # as any second owner is, in test_service.py
def test_a_second_bridge_beside_it_is_refused(up: Up, tmp_path: Path) -> None:
    with ServiceProcess("ros_bridge", up.endpoint, tmp_path, robot=ROBOT) as second:
        assert second.process.wait(PATIENCE) == 1
        assert "already on this bus" in second.output()


@pytest.mark.slow  # as a planner is, in test_up_faults.py
def test_a_bridge_that_dies_is_started_again(up: Up, node: Node) -> None:
    with Bus(up.endpoint) as bus:
        old = pid(bus, "ros_bridge")
        os.kill(old, signal.SIGKILL)
        wait_replaced(bus, "ros_bridge", old)
    said = "zarm: the ros_bridge has ended (terminated by SIGKILL) and is started again"
    eventually(lambda: said in up.errors(), "the user is told")


@pytest.mark.slow
def test_the_bridge_ends_with_the_rest(tmp_path: Path) -> None:
    unsaid = {"FASTRTPS_DEFAULT_PROFILES_FILE": "", "ROS_AUTOMATIC_DISCOVERY_RANGE": ""}
    with Up(free_endpoint(), tmp_path, "--ros", **unsaid) as up:
        reach = {process.environ()["ROS_AUTOMATIC_DISCOVERY_RANGE"] for process in up.family()}
        assert reach == {"LOCALHOST"}  # where the user has said nothing
        up.interrupt()
        assert up.end() == 0
        assert not up.family()
        for never in ("Traceback", "strategy unknown", "DDS listens on every interface"):
            assert never not in up.errors()


@pytest.mark.slow
def test_a_bridge_joins_a_bus_that_runs(tmp_path: Path, node: Node) -> None:
    with Up(free_endpoint(), tmp_path) as up, Bus(up.endpoint) as bus:
        assert health(bus, "ros_bridge") is None
        with ServiceProcess("ros_bridge", up.endpoint, tmp_path, robot=ROBOT) as bridge:
            bridge.wait_ready(bus, KEYS)
            assert RosClient(node).call(Trigger, "get_robot_strategy").success
        assert bridge.process.returncode == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("missing", "said"),
    [
        ("curobo_msgs", "curobo_msgs cannot be imported here; `make ros`"),
        ("numba", "the planner cannot run, because numba cannot be imported here; `pip install 'zarm[planner]'`"),
    ],
)
def test_without_its_packages_up_says_how_to_get_them(tmp_path: Path, missing: str, said: str) -> None:
    hidden = f"import sys; sys.modules['{missing}'] = None; sys.argv[0] = 'zarm'; from zarm_cli.app import main; main()"
    command = [sys.executable, "-c", hidden, "up", "--ros", "--listen", free_endpoint(), "--state", str(tmp_path)]
    ended = subprocess.run(command, env=environment(), capture_output=True, text=True, timeout=PATIENCE)
    assert ended.returncode == 3, ended.stderr
    assert said in ended.stderr
