"""`zarm up`: one command that starts what a robot needs, says so, and leaves nothing behind."""

from __future__ import annotations

import json
import re
import signal
import socket
from pathlib import Path

import pytest

from support.command_line import ROBOT, SERVICES, Command, Up, the_one_line, zarm
from support.harness import eventually, free_endpoint
from support.tiers import sampled
from support.undriven_panda import undriven_panda
from zarm_contract.keys import ALL_ALIVE
from zarm_runtime.bus import Bus


def test_up_says_what_runs_where_and_what_to_try_next(up: Up, empty_scene: None) -> None:
    assert ROBOT in up.output()
    assert up.endpoint in up.output()
    assert "emulator" in up.output()
    words = next(line for line in up.output().splitlines() if "zarm execute" in line).split()
    done = zarm(*words[words.index("zarm") + 1 :])
    assert done.returncode == 0, done.stderr


def test_physics_for_a_robot_without_a_driver_is_refused(tmp_path: Path) -> None:
    refused = zarm("up", "--robot", str(undriven_panda(tmp_path)), "--driver", "physics", "--listen", free_endpoint())
    assert refused.returncode == 1
    assert "panda has no strategy_params in its descriptor" in the_one_line(refused.stderr)


def test_settings_of_physics_without_physics_are_refused() -> None:
    refused = zarm("up", "--driver", "sim", "--drives", "hobby")
    assert refused.returncode == 2
    assert "--driver physics" in the_one_line(refused.stderr)


@pytest.mark.parametrize(
    ("option", "remedy"),
    [("--map-box", "add --perception"), ("--map-resolution", "add --perception"), ("--group", "add --moveit")],
)
def test_settings_of_what_is_not_started_are_refused(option: str, remedy: str) -> None:
    refused = zarm("up", option, "0.01")
    assert refused.returncode == 2
    assert remedy in the_one_line(refused.stderr)


@pytest.mark.parametrize("interface", ["--ros", "--moveit"])
def test_ros_faster_than_real_time_is_refused(interface: str) -> None:
    refused = zarm("up", interface, "--speed", "2")
    assert refused.returncode == 1
    assert "ROS 2 runs in real time" in the_one_line(refused.stderr)


def test_a_second_up_for_the_same_robot_is_refused(up: Up) -> None:
    with Bus(up.endpoint) as bus:
        before = bus.alive(ALL_ALIVE)
        for where in ("--listen", "--connect"):
            second = zarm("up", where, up.endpoint)
            assert second.returncode == 1
            assert f"the robot {ROBOT} is already up" in the_one_line(second.stderr)
        assert bus.alive(ALL_ALIVE) == before


@pytest.mark.slow  # two names on a bus are in executor/test_goals.py and client/test_robot.py
def test_a_second_robot_joins_the_bus_under_another_name(up: Up, tmp_path: Path) -> None:
    with Up(up.endpoint, tmp_path, joins=True, name="left") as joined:
        assert f"--connect {up.endpoint} --name left" in joined.output(), "the example is for this robot"
        unclear = zarm("status", ZARM_CONNECT=up.endpoint)
        assert unclear.returncode == 1
        assert f"{ROBOT}, left" in the_one_line(unclear.stderr)
        chosen = zarm("status", "--json", ZARM_CONNECT=up.endpoint, ZARM_NAME="left")
        assert chosen.returncode == 0
        assert json.loads(chosen.stdout)["robot"] == "left"


@pytest.mark.slow  # as the guide to commissioning does, which is run
def test_a_simulated_driver_is_started_where_it_is_asked_for(tmp_path: Path) -> None:
    with Up(free_endpoint(), tmp_path, "--driver", "sim", "--strategy", "joint_speed") as up:
        assert "joint_speed" in up.output()
        moved = zarm("execute", "--joints", "0.2,0,1.570796,0,1.570796,0", ZARM_CONNECT=up.endpoint)
        assert moved.returncode == 0, moved.stderr
        with Bus(up.endpoint) as bus:
            assert "leeloo_sim" in {service for _, service, _ in bus.alive(ALL_ALIVE)}


def test_ctrl_c_stops_the_executor_first_and_leaves_no_process(tmp_path: Path) -> None:
    with Up(free_endpoint(), tmp_path) as up:
        assert len(up.family()) > len(SERVICES)
        up.interrupt()
        up.interrupt()  # a second one changes nothing
        assert up.end() == 0
        assert up.family() == []
        lines = [line for line in up.errors().splitlines() if line.endswith("stopping")]
        assert [line.split()[0] for line in lines] == ["executor", "servo", "planner"]


@pytest.mark.slow
def test_an_unknown_strategy_ends_the_launch_with_json_logs(tmp_path: Path) -> None:
    arguments = ("up", "--strategy", "telepathy", "--listen", free_endpoint(), "--state", str(tmp_path))
    with Command(*arguments, folder=tmp_path, ZARM_LOG_FORMAT="json") as up:
        assert up.end() == 3
        assert up.family() == []
        *lines, last = up.errors().splitlines()
    assert re.fullmatch(r"zarm: unavailable: the executor cannot start: there is no strategy .telepathy.*", last)
    assert {json.loads(line)["robot"] for line in lines} == {ROBOT}


@pytest.mark.slow
@pytest.mark.parametrize("number", sampled(signal.SIGTERM, signal.SIGINT))
def test_an_interrupt_before_anything_is_ready_leaves_no_process(tmp_path: Path, number: signal.Signals) -> None:
    arguments = ("up", "--listen", free_endpoint(), "--state", str(tmp_path))
    with Command(*arguments, folder=tmp_path) as up:
        eventually(lambda: any("zarm_executor.service" in one for one in up.command_lines()), "the executor starts")
        up.interrupt(number)
        assert up.end() == 0
        assert up.family() == []


def test_a_taken_port_is_said_in_one_line(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        refused = zarm("up", "--listen", f"tcp/127.0.0.1:{taken.getsockname()[1]}", "--state", str(tmp_path))
    assert refused.returncode == 3
    assert "--listen" in the_one_line(refused.stderr)


def test_joining_a_router_that_is_not_there_is_said_in_one_line(tmp_path: Path) -> None:
    refused = zarm("up", "--connect", free_endpoint(), "--state", str(tmp_path))
    assert refused.returncode == 3
    assert "no Zenoh router" in the_one_line(refused.stderr)


def test_an_unknown_robot_is_said_with_those_that_are_known() -> None:
    refused = zarm("up", "--robot", "r2d2", "--listen", free_endpoint())
    assert refused.returncode == 1
    assert "r2d2" in the_one_line(refused.stderr)
    assert ROBOT in refused.stderr


def test_malformed_yaml_is_said_with_file_and_line(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("name: mine\njoints: [a, b\nhome: [0, 0]\n")
    refused = zarm("up", "--robot", str(file), "--listen", free_endpoint())
    assert refused.returncode == 1
    assert f"{file}:3" in the_one_line(refused.stderr)


@pytest.mark.slow
def test_an_unknown_strategy_ends_the_launch_with_its_reason(tmp_path: Path) -> None:
    arguments = ("up", "--strategy", "telepathy", "--listen", free_endpoint(), "--state", str(tmp_path))
    with Command(*arguments, folder=tmp_path) as up:
        assert up.end() == 3
        last = up.errors().splitlines()[-1]
        assert last.startswith("zarm: unavailable: the executor cannot start: ")
        assert "telepathy" in last
        assert up.family() == []


def test_listening_and_connecting_at_once_is_a_usage_error() -> None:
    refused = zarm("up", "--listen", free_endpoint(), "--connect", free_endpoint())
    assert refused.returncode == 2
    assert "--listen" in the_one_line(refused.stderr)


def test_an_option_beats_the_environment(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        listens = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        refused = zarm("up", "--listen", listens, "--state", str(tmp_path), ZARM_CONNECT=free_endpoint())
    assert (refused.returncode, "--listen" in the_one_line(refused.stderr)) == (3, True)
    refused = zarm("up", "--connect", free_endpoint(), "--state", str(tmp_path), ZARM_LISTEN=free_endpoint())
    assert (refused.returncode, "no Zenoh router" in refused.stderr) == (3, True)
