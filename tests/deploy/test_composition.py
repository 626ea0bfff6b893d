"""The services in containers do together what they do as processes, and come back when they fall."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from support.deploy.composition import SERVICES, Composition, docker
from support.executor.client import Client
from support.trajectories import HOME, KEYS, moved, rest_to_rest
from zarm_contract.keys import Keys
from zarm_contract.messages import Nothing, Scene
from zarm_contract.robot import ROBOTS
from zarm_runtime.bus import Bus

pytestmark = pytest.mark.timeout(400)

ON_ROS = Path(__file__).with_name("on_ros.py")
ZENOH = str(Path(sys.executable).with_name("zenoh"))


@pytest.fixture(scope="module")
def robot() -> Iterator[Composition]:
    """Router, planner, executor and bridge of an M1013 on the emulator."""
    with Composition() as composition:
        composition.up()
        yield composition


@pytest.fixture
def bus(robot: Composition) -> Iterator[Bus]:
    """A session on the published port."""
    with Bus(robot.endpoint) as session:
        yield session


def joints(bus: Bus, keys: Keys = KEYS) -> np.ndarray:
    state = bus.latest(keys.joint_states).wait(10)
    assert state is not None
    return np.array(state.position)


def scene(bus: Bus) -> Scene:
    return bus.read(KEYS.scene, timeout=10)


def go(robot: Composition, joint_1: float) -> None:
    """Plan and execute from this machine."""
    robot.zarm("plan", "--joints", ",".join(map(str, (joint_1, *HOME[1:]))))
    assert "succeeded" in robot.zarm("execute")


def test_zarm_on_this_machine_plans_and_executes(robot: Composition, bus: Bus) -> None:
    robot.zarm("scene", "add", "cuboid", "table", "--at", "0.5,0,-0.1", "--size", "1,1,0.1")
    go(robot, 0.3)
    assert joints(bus)[0] == pytest.approx(0.3, abs=1e-3)


def test_the_zenoh_command_line_reads_and_plans(robot: Composition) -> None:
    goal = {"goal": {"kind": "joints", "position": [0.2, *HOME[1:]]}}
    for key, *value in ((KEYS.executor_state,), (KEYS.plan, "-v", json.dumps(goal))):
        words = ["--mode", "client", "--connect", robot.endpoint, "get", "--decoder", "json", "-s", key, *value]
        done = subprocess.run([ZENOH, *words], capture_output=True, text=True, timeout=60)
        answer = json.loads(done.stdout)
        assert {"mode", "trajectory"} & set(answer), done.stderr


def test_a_ros_client_in_another_container_plans_and_executes(robot: Composition) -> None:
    reported = robot.ros_client(ON_ROS)
    assert reported["planned"]
    assert reported["points"] > 10
    assert "EXECUTING" in reported["states"]
    assert reported["succeeded"]


@pytest.mark.parametrize("service", SERVICES)
def test_a_container_has_no_more_rights_than_it_needs(robot: Composition, service: str) -> None:
    host = robot.container(service)["HostConfig"]
    assert host["ReadonlyRootfs"]
    assert host["CapDrop"] == ["ALL"]
    assert host["CapAdd"] is None
    assert "no-new-privileges:true" in host["SecurityOpt"]
    assert not host["Privileged"]
    assert host["LogConfig"] == {"Type": "json-file", "Config": {"max-file": "5", "max-size": "10m"}}
    assert host["RestartPolicy"]["Name"] == "unless-stopped"
    ports = [port["HostIp"] for published in (host["PortBindings"] or {}).values() for port in published]
    assert set(ports) <= {"127.0.0.1"}
    status = robot.inside(service, "grep", "CapPrm\\|CapBnd\\|Uid", "/proc/1/status")
    assert re.findall(r"Cap(?:Prm|Bnd):\s+0{16}$", status, re.MULTILINE) != []
    assert "Uid:\t0" not in status


@pytest.mark.parametrize("service", SERVICES)
def test_a_service_that_crashes_is_back_with_all_that_it_knew(robot: Composition, bus: Bus, service: str) -> None:
    go(robot, 0.2)
    where, what = joints(bus), scene(bus)
    assert [item.name for item in what.objects] == ["table"]
    robot.crash(service)
    with Bus(robot.endpoint) as after:
        np.testing.assert_allclose(joints(after), where, atol=1e-6)
        assert scene(after) == what
    go(robot, 0.3)


def test_a_moving_robot_rests_before_its_container_stops(robot: Composition, bus: Bus) -> None:
    client = Client(bus)
    start = joints(bus)
    goal = client.execute(rest_to_rest(moved(1.2), start, slower=10.0))  # compose takes its time
    client.under_way(goal, 0.1)
    robot.compose("stop", "executor")
    state = robot.container("executor")["State"]
    assert (state["ExitCode"], state["OOMKilled"]) == (0, False)
    assert client.statuses(goal)[-1] == "cancelled"
    last = client.measured[-1]
    assert not any(last.velocity)
    assert start[0] < last.position[0] < moved(1.2)[0] - 0.01
    assert client.greatest_acceleration() < 1.2
    robot.up("executor")
    np.testing.assert_allclose(joints(bus), last.position, atol=1e-6)


def test_the_simulated_driver_is_moved_over_ros(robot: Composition, bus: Bus) -> None:
    robot.up(profile="sim", ZARM_STRATEGY="joint_speed")
    strategies = bus.read(KEYS.strategy, timeout=10)
    assert strategies.active == "joint_speed"
    before = joints(bus)[0]
    go(robot, before + 0.3)
    assert joints(bus)[0] == pytest.approx(before + 0.3, abs=0.01)
    robot.crash("executor")
    assert bus.read(KEYS.strategy, timeout=10).active == "joint_speed"
    robot.compose("--profile", "sim", "rm", "-sf", "leeloo_sim")


def test_another_robot_or_the_user_s_own_takes_one_setting(robot: Composition, bus: Bus, tmp_path: Path) -> None:
    own = (ROBOTS / "ur5e.yaml").read_text().replace("name: ur5e", "name: mine", 1)
    (tmp_path / "mine.yaml").write_text(own)
    shutil.copy(ROBOTS / "ur5e.urdf", tmp_path)
    for path in (tmp_path, *tmp_path.iterdir()):
        path.chmod(0o755)
    for setting, name in (("ur5e", "ur5e"), ("/robots/mine.yaml", "mine")):
        robot.up(ZARM_ROBOT=setting, ZARM_ROBOTS=str(tmp_path))
        keys = Keys(name)
        assert bus.call(keys.health("planner"), Nothing(), timeout=10).ready
        target = joints(bus, keys) + 0.1
        robot.zarm("execute", "--name", name, "--joints", ",".join(map(str, target)))
        np.testing.assert_allclose(joints(bus, keys), target, atol=1e-3)


def test_with_security_each_container_has_its_own_certificate(tmp_path: Path) -> None:
    certificates = tmp_path / "certs"
    with Composition("compose.security.yaml") as robot:
        robot.zarm("certs", str(certificates), "--host", "router")
        tmp_path.chmod(0o755)
        if os.getuid() == 0:
            for file in certificates.iterdir():
                os.chown(file, 1000, 1000)
        mine = {"ZARM_CERTS": str(certificates), "ZARM_SECURITY": "on"}
        robot.up(ZARM_CERTS=str(certificates))
        for service, role in zip(SERVICES, ("router", "planner", "servo", "executor", "bridge"), strict=True):
            keys = {name for name in robot.inside(service, "ls", "/certs").split() if name.endswith(".key")}
            assert keys == {f"{role}.key", "viewer.key"}
        robot.zarm("plan", "--joints", ",".join(map(str, (0.3, *HOME[1:]))), **mine)
        assert "succeeded" in robot.zarm("execute", **mine)
        with pytest.raises(AssertionError, match=r"ZARM_SECURITY|certificate|TLS"):
            robot.zarm("status")


def test_what_is_taken_down_leaves_nothing(robot: Composition) -> None:
    assert robot.left()
    robot.down()
    assert robot.left() == []
    assert robot.project not in docker("volume", "ls", "-q").stdout
