"""Both tutorials, command by command, each in a process of its own: those of curobo_ros, and what zarm's say of ROS."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
import yaml

from support.harness import PATIENCE, ServiceProcess, eventually, router
from support.markdown import PAGES, commands
from support.paths import PROGRAMS, SHARED
from support.ros.stack import KEYS
from support.trajectories import patient
from zarm_runtime.bus import Bus

REFERENCE = SHARED / "reference"
NODE = "/unified_planner"
PLAN = f"ros2 service call {NODE}/generate_trajectory curobo_msgs/srv/TrajectoryGeneration "
PLAN_1 = PLAN + '"{target_pose: {position: {x: 0.5, y: 0.2, z: 0.3}, orientation: {w: 1.0}}}"'
PLAN_2 = PLAN + '"{target_pose: {position: {x: 0.5, y: 0.0, z: 0.4}, orientation: {w: 1.0}}}"'
EXECUTE = f'ros2 action send_goal {NODE}/execute_trajectory curobo_msgs/action/SendTrajectory "{{}}"'
EXECUTE_TARGET = (
    f"ros2 action send_goal {NODE}/execute_trajectory curobo_msgs/action/SendTrajectory "
    '"{target_pose: {position: {x: 0.5, y: 0.2, z: 0.4}, orientation: {x: 0.0, y: 1.0, z: 0.0, w: 0.0}}}" --feedback'
)
APPLY = f"ros2 service call {NODE}/set_robot_strategy std_srvs/srv/Trigger"
ACTIVE = f"ros2 service call {NODE}/get_robot_strategy std_srvs/srv/Trigger"
LISTED = f"ros2 service call {NODE}/get_robot_strategies curobo_msgs/srv/GetRobotStrategies"
SWITCH = (
    f"ros2 service call {NODE}/set_robot_strategy curobo_msgs/srv/SetRobotStrategy \"{{robot_strategy: 'emulator'}}\""
)
PLANNER = {
    number: f'ros2 service call {NODE}/set_planner curobo_msgs/srv/SetPlanner "{{planner_type: {number}}}"'
    for number in (0, 1)
}
MPC_MOVE = (
    f"ros2 action send_goal {NODE}/mpc_move curobo_msgs/action/MpcMove "
    '"{target_pose: {position: {x: 0.5, y: 0.1, z: 0.5}, orientation: {x: 0.0, y: 1.0, z: 0.0, w: 0.0}}}" --feedback'
)
CHOOSE = {kind: f'ros2 param set {NODE} robot_type "{kind}"' for kind in ("ghost", "emulator", "doosan_m1013", "")}
DRIVER_HZ, EMULATOR_HZ = "ros2 topic hz /dsr01/joint_states", "ros2 topic hz /emulator/joint_states"
TOPICS, COMMAND_INFO = "ros2 topic list", "ros2 topic info /leeloo/execute_trajectory"
COMMANDS = (
    *(PLAN_1, PLAN_2, EXECUTE, EXECUTE_TARGET, APPLY, ACTIVE, LISTED, SWITCH),
    *PLANNER.values(),
    MPC_MOVE,
    *CHOOSE.values(),
    *(DRIVER_HZ, EMULATOR_HZ, TOPICS, COMMAND_INFO),
)


def ros2(command: str) -> str:
    """What a command prints: that of ROS where this machine has it, else the same calls by rclpy."""
    assert command in COMMANDS
    words = shlex.split(command)
    if shutil.which("ros2") is None:
        words = [sys.executable, str(PROGRAMS / "ros2_command.py"), *words[1:]]
    ended = subprocess.run(words, capture_output=True, text=True, timeout=2 * PATIENCE)
    assert ended.returncode == 0, ended.stderr
    return ended.stdout


@pytest.fixture(scope="module")
def bus(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bus]:
    """The whole of zarm, and the driver of the robot on the side of ROS."""
    folder = tmp_path_factory.mktemp("tutorials")
    robot = str(patient(folder / "patient"))
    with router() as endpoint, Bus(endpoint) as session:
        processes = [
            ServiceProcess(name, endpoint, folder, robot, KEYS.robot, arguments=arguments)
            for name, arguments in (
                ("leeloo_sim", ("--ros",)),
                ("planner", ()),
                ("executor", ()),
                ("servo", ()),
                ("ros_bridge", ()),
            )
        ]
        with ExitStack() as started:
            for process in processes:
                started.enter_context(process)
            for process in processes[1:]:
                process.wait_ready(session, KEYS)
            yield session
            for process in processes:
                assert process.process.poll() is None, process.output()


def test_every_command_of_the_reference_is_run_here() -> None:
    texts = [REFERENCE / name for name in ("robot-execution-v1.txt", "robot-execution-v2.txt")]
    if not all(text.exists() for text in texts):
        pytest.skip("the tutorials are not here")
    for text in texts:
        plain = " ".join(text.read_text().replace("\\", " ").split())
        found = [match.start() for match in re.finditer(r"ros2 (param|service|action|topic) ", plain)]
        assert found
        for start in found:
            assert any(plain.startswith(command, start) for command in COMMANDS), plain[start : start + 120]


@pytest.mark.parametrize(
    "page", [page for page in PAGES if page.parent.name == "tutorials"], ids=lambda page: page.stem
)
def test_every_command_of_a_tutorial_is_run_here(page: Path) -> None:
    known = [shlex.split(command) for command in COMMANDS]
    for words in commands(page.read_text(), "ros2"):
        typed = words[: words.index("|")] if "|" in words else words
        assert typed in known, " ".join(words)


@pytest.mark.slow
def test_version_1_ghost(bus: Bus) -> None:
    assert "Set parameter successful" in ros2(CHOOSE["ghost"])
    assert "success: true" in ros2(APPLY)
    planned = ros2(PLAN_1)
    assert "success: true" in planned
    assert "dt: " in planned
    assert "ghost" in ros2(ACTIVE)


@pytest.mark.slow
def test_version_1_emulator(bus: Bus) -> None:
    ros2(CHOOSE["ghost"])
    ros2(APPLY)
    assert "Set parameter successful" in ros2(CHOOSE["emulator"])
    answered = yaml.safe_load(ros2(APPLY))
    assert answered == {"success": True, "message": "Strategy switched from 'ghost' to 'emulator'"}
    assert rate(ros2(EMULATOR_HZ)) > 10
    planned = yaml.safe_load(ros2(PLAN_1))
    assert planned["success"], planned["message"]
    assert_executed(ros2(EXECUTE))
    end = planned["trajectory"][-1]
    assert np.allclose(measured(bus), end["position"], atol=1e-3)


@pytest.mark.slow
def test_version_1_doosan(bus: Bus) -> None:
    assert rate(ros2(DRIVER_HZ)) > 20
    eventually(lambda: "/leeloo/execute_trajectory" in ros2(TOPICS).splitlines(), "the driver's topic is found")
    eventually(lambda: "Subscription count: 1" in ros2(COMMAND_INFO), "the driver is found to listen")
    ros2(CHOOSE["emulator"])
    ros2(APPLY)
    ros2(CHOOSE["doosan_m1013"])
    answered = yaml.safe_load(ros2(APPLY))
    assert answered == {"success": True, "message": "Strategy switched from 'emulator' to 'doosan_m1013'"}
    planned = yaml.safe_load(ros2(PLAN_2))
    assert planned["success"], planned["message"]
    assert_executed(ros2(EXECUTE))
    assert np.allclose(measured(bus), planned["trajectory"][-1]["position"], atol=0.02)


@pytest.mark.slow  # as the parameter is, in one_stack
def test_version_1_refuses_a_robot_type_that_is_none(bus: Bus) -> None:
    report = ros2(CHOOSE[""])
    assert "Setting parameter failed" in report
    assert "choose one of emulator, ghost, joint_speed, joint_pose, doosan_m1013" in report


@pytest.mark.slow  # every call is made in one_stack too
def test_version_2(bus: Bus) -> None:
    ros2(CHOOSE["ghost"])
    ros2(APPLY)
    listed = yaml.safe_load(ros2(LISTED))
    assert listed["success"]
    assert {"emulator", "joint_speed", "joint_pose"} <= set(listed["strategy_names"])
    assert listed["current_strategy_name"] == "ghost"
    switched = yaml.safe_load(ros2(SWITCH))
    assert switched["success"]
    assert (switched["previous_robot_strategy"], switched["current_robot_strategy"]) == ("ghost", "emulator")
    assert "emulator" in ros2(ACTIVE)
    report = ros2(EXECUTE_TARGET)
    assert_executed(report)
    for name in ("state: EXECUTING", "step_progression: ", "joint_command:"):
        assert name in report


@pytest.mark.slow
def test_version_2_in_closed_loop(bus: Bus) -> None:
    assert yaml.safe_load(ros2(SWITCH))["success"]
    chosen = yaml.safe_load(ros2(PLANNER[1]))
    assert (chosen["success"], chosen["current_planner"]) == (True, "mpc")
    report = ros2(MPC_MOVE)
    assert "Target reached" in report
    assert "Goal finished with status: SUCCEEDED" in report
    assert yaml.safe_load(ros2(PLANNER[0]))["previous_planner"] == "mpc"


def assert_executed(printed: str) -> None:
    assert "success: true" in printed
    assert "message: Trajectory executed successfully" in printed.replace("'", "")
    assert "Goal finished with status: SUCCEEDED" in printed


def rate(printed: str) -> float:
    found = re.search(r"average rate: ([0-9.]+)", printed)
    assert found, printed
    return float(found[1])


def measured(bus: Bus) -> tuple[float, ...]:
    latest = bus.latest(KEYS.joint_states)
    while (state := latest.get(max_age=1.0)) is None:
        pass
    return state.position
