"""What every service process promises: one owner per robot, a health, a clean end, one line when it cannot run."""

from __future__ import annotations

import argparse
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from support.harness import PATIENCE, ServiceProcess, eventually, free_endpoint, nothing_compiled
from support.paths import PROGRAMS
from support.tiers import sampled
from zarm_contract.errors import InvalidRequest, Unavailable
from zarm_contract.key import Token
from zarm_contract.keys import Keys
from zarm_contract.messages import Health, Nothing
from zarm_contract.robot import load_robot
from zarm_runtime.bus import Bus
from zarm_runtime.service import CONTRACT, Service, default_state, service_parser, version

PROGRAM = PROGRAMS / "minimal_service.py"
KEYS = Keys("pendulum")

Process = subprocess.Popen[str]
Start = Callable[..., Process]


@pytest.fixture
def start(endpoint: str, pendulum: Path) -> Iterator[Start]:
    """Starts minimal services, and ends those that still run."""
    processes: list[Process] = []

    def run(*arguments: str, connect: str = endpoint, robot: str = str(pendulum)) -> Process:
        command = [sys.executable, PROGRAM, "--robot", robot, "--connect", connect, *arguments]
        clean = {name: value for name, value in os.environ.items() if not name.startswith("ZARM_")}
        processes.append(
            subprocess.Popen(command, env=clean, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        )
        return processes[-1]

    yield run
    for process in processes:
        if process.poll() is None:
            process.kill()
        process.communicate()


def health(bus: Bus, keys: Keys = KEYS) -> Health | None:
    """The health of the minimal service once it is ready."""
    try:
        answer = bus.call(keys.health("minimal"), Nothing(), timeout=PATIENCE)
    except Unavailable:
        return None
    return answer if answer.ready else None


def ended(process: Process) -> tuple[int, list[str]]:
    """The exit code of a process that ends by itself, and the lines of its log."""
    _, log = process.communicate(timeout=PATIENCE)
    return process.returncode, log.splitlines()


# -- life and death --


@pytest.mark.parametrize("number", sampled(signal.SIGTERM, signal.SIGINT), ids=["SIGTERM", "SIGINT"])
def test_a_signal_ends_a_service_cleanly(start: Start, bus: Bus, number: signal.Signals) -> None:
    process = start()
    eventually(lambda: health(bus), "the service is ready")
    process.send_signal(number)
    output, log = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0
    assert output == "closed\n"
    assert [line.split("level=INFO ")[1].split()[0] for line in log.splitlines()] == ["starting", "ready", "stopping"]
    assert health(bus) is None
    eventually(lambda: bus.alive(KEYS.alive("minimal", "*")) == [], "its token is gone")


@pytest.mark.parametrize(
    ("name", "first", "later"),
    sampled(
        ("planner", "forward_kinematics", "inverse_kinematics"),  # the stage between may begin before the signal
        ("servo", "the_check_of_motions", "the_control_of_sessions"),
    ),
    ids=["planner", "servo"],
)
def test_a_service_compiling_kernels_ends_at_the_next_stage(
    endpoint: str, bus: Bus, tmp_path: Path, name: str, first: str, later: str
) -> None:
    with ServiceProcess(name, endpoint, tmp_path, environment=nothing_compiled(tmp_path)) as service:
        eventually(lambda: f"loading_{first}" in service.output(), "it compiles")
        service.process.terminate()
        assert service.process.wait(PATIENCE) == 0
    assert f"loading_{later}" not in service.output()
    assert service.output().splitlines()[-1].endswith("stopping")
    assert "Traceback" not in service.output()
    assert bus.alive(Keys("doosan_m1013").alive(name, "*")) == []


def test_a_service_says_how_it_is(start: Start, bus: Bus, pendulum: Path) -> None:
    process = start()
    answer = eventually(lambda: health(bus), "the service is ready")
    ((_, _, instance),) = bus.alive(KEYS.alive("minimal", "*"))
    assert answer == Health(
        service="minimal",
        robot="pendulum",
        instance=instance,
        ready=True,
        activity="serving",
        version=version(),
        contract=CONTRACT,
        robot_hash=load_robot(str(pendulum)).hash,
        uptime=answer.uptime,
        pid=process.pid,
    )


def test_a_second_robot_of_a_kind_has_a_name_of_its_own(start: Start, bus: Bus) -> None:
    start()
    start("--name", "pendulum_2")
    for keys in (KEYS, Keys("pendulum_2")):
        eventually(lambda keys=keys: health(bus, keys), "the service is ready")


def reread(bus: Bus) -> Health:
    return bus.call(KEYS.reread("minimal"), Nothing(), timeout=PATIENCE)


def test_a_service_restarts_with_the_changed_descriptor(start: Start, bus: Bus, pendulum: Path) -> None:
    process = start()
    before = eventually(lambda: health(bus), "the service is ready")
    assert reread(bus).instance == before.instance
    pendulum.write_text(pendulum.read_text() + "\n# a remark\n")
    assert reread(bus).robot_hash == before.robot_hash

    def renewed() -> Health | None:
        now = health(bus)
        return now if now is not None and now.robot_hash != before.robot_hash else None

    after = eventually(renewed, "the service has taken the file")
    assert after.pid == before.pid == process.pid
    assert after.instance != before.instance
    process.send_signal(signal.SIGTERM)
    output, _ = process.communicate(timeout=PATIENCE)
    assert (process.returncode, output) == (0, "closed\nclosed\n")


def test_a_service_goes_on_where_the_changed_file_has_faults(start: Start, bus: Bus, pendulum: Path) -> None:
    start()
    before = eventually(lambda: health(bus), "the service is ready")
    pendulum.write_text(pendulum.read_text().replace("joints:", "joint:"))
    with pytest.raises(InvalidRequest, match=re.escape(str(pendulum))):
        reread(bus)
    now = health(bus)
    assert now is not None
    assert (now.instance, now.ready) == (before.instance, True)


# -- one owner --


def test_a_second_owner_is_refused_while_the_first_lives(start: Start, bus: Bus) -> None:
    first = start()
    owner = eventually(lambda: health(bus), "the first is ready")
    code, log = ended(start())
    assert code == 1
    assert len(log) == 1
    assert f"already on this bus (instance {owner.instance})" in log[0]
    assert "--name" in log[0]
    assert first.poll() is None
    assert eventually(lambda: health(bus), "the first still answers").pid == first.pid


def test_an_owner_that_was_killed_can_be_replaced(start: Start, bus: Bus) -> None:
    first = start()
    eventually(lambda: health(bus), "the first is ready")
    first.kill()
    first.wait()
    eventually(lambda: bus.alive(KEYS.alive("minimal", "*")) == [], "the router has noticed")
    second = start()
    assert eventually(lambda: health(bus), "the second is ready").pid == second.pid


def test_of_two_that_start_at_once_exactly_one_stays(start: Start, bus: Bus) -> None:
    two = [start(), start()]
    loser = eventually(lambda: next((p for p in two if p.poll() is not None), None), "one gives up")
    assert ended(loser)[0] == 1
    (winner,) = (process for process in two if process is not loser)
    assert eventually(lambda: health(bus), "the other is ready").pid == winner.pid


def service(bus: Bus, descriptor: Path, instance: str) -> Service:
    """A service that is only made, in this process."""
    return Service("minimal", load_robot(str(descriptor)), KEYS, bus, argparse.Namespace(), instance=instance)


def test_of_two_owners_that_meet_the_younger_knows_and_ends(start: Start, bus: Bus, pendulum: Path) -> None:
    """As after a router that was away: neither saw the other when it claimed the robot."""
    process = start()
    owner = eventually(lambda: health(bus), "it is ready")
    bus.declare_alive(KEYS.alive("minimal", "f" * 15))  # a younger one does not disturb it
    assert service(bus, pendulum, owner.instance).older_owner() is None
    assert process.poll() is None
    bus.declare_alive(KEYS.alive("minimal", "0" * 15))
    code, log = ended(process)
    assert code == 1
    assert "already on this bus (instance 000000000000000)" in log[-1]


def test_an_instance_sorts_by_the_time_of_its_start(bus: Bus, pendulum: Path) -> None:
    robot = load_robot(str(pendulum))
    first = Service("minimal", robot, KEYS, bus, argparse.Namespace())
    began = time.time_ns() // 1_000_000
    eventually(lambda: time.time_ns() // 1_000_000 > began, "another millisecond has begun")
    assert first.instance < Service("minimal", robot, KEYS, bus, argparse.Namespace()).instance


def test_whoever_is_refused_never_shows_a_token(endpoint: str, pendulum: Path) -> None:
    with Bus(endpoint) as first, Bus(endpoint) as second:
        service(first, pendulum, "bbbb").claim()
        for instance in ("aaaa", "cccc"):
            with pytest.raises(Unavailable, match="instance bbbb"):
                service(second, pendulum, instance).claim()
        assert first.alive(KEYS.alive("minimal", "*")) == [("pendulum", "minimal", "bbbb")]


def test_of_two_owners_that_claim_one_robot_one_stays(endpoint: str, pendulum: Path) -> None:
    """Both have looked and seen nobody; then one claims, then the other, whose id would win a tie."""
    with Bus(endpoint) as first_bus:
        first = service(first_bus, pendulum, "bbbb")

        class LateBus(Bus):
            def declare_alive(self, key: Token) -> None:
                first.claim()
                super().declare_alive(key)

        with LateBus(endpoint) as second_bus, pytest.raises(Unavailable, match="instance bbbb"):
            service(second_bus, pendulum, "aaaa").claim()
        assert first_bus.alive(KEYS.alive("minimal", "*")) == [("pendulum", "minimal", "bbbb")]


# -- what cannot run --


def test_an_unknown_robot_is_one_line_with_the_remedy(start: Start) -> None:
    code, log = ended(start(robot="r2d2"))
    assert code == 1
    assert len(log) == 1
    assert log[0].startswith("minimal   | ")
    assert "unknown robot 'r2d2'" in log[0]
    assert "path of a .yaml" in log[0]


@pytest.mark.slow
def test_without_a_router_there_is_one_line_with_the_remedy(start: Start) -> None:
    endpoint = free_endpoint()
    code, log = ended(start(connect=endpoint))
    assert code == 1
    assert len(log) == 1
    assert f"no Zenoh router answers at {endpoint}; start one with `zarm up`" in log[0]


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [(("--name", "Arm 2"), "use lower case letters"), (("--fault", "refusal"), "this cannot work; do that")],
    ids=["bad name", "refusal of the service itself"],
)
def test_what_else_cannot_run_is_one_line_as_well(start: Start, arguments: tuple[str, ...], reason: str) -> None:
    code, log = ended(start(*arguments))
    assert code == 1
    errors = [line for line in log if "level=ERROR" in line]
    assert len(errors) == 1
    assert reason in errors[0]
    assert log[-1] == errors[0]


def test_a_fault_of_the_service_keeps_its_trace(start: Start) -> None:
    code, log = ended(start("--fault", "bug"))
    assert code == 1
    assert log[-1] == "ZeroDivisionError: a fault of the service"


# -- settings --


def test_options_come_from_the_environment_unless_given(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("ZARM_ROBOT", "ur5e")
    monkeypatch.setenv("ZARM_CONNECT", "tcp/127.0.0.1:1234")
    monkeypatch.setenv("ZARM_STATE", str(tmp_path))
    options = service_parser("minimal").parse_args([])
    assert (options.robot, options.connect, options.state) == ("ur5e", "tcp/127.0.0.1:1234", tmp_path)
    options = service_parser("minimal").parse_args(["--robot", "panda", "--connect", "tcp/[::1]:1", "--state", "/x"])
    assert (options.robot, options.connect, options.state) == ("panda", "tcp/[::1]:1", Path("/x"))


def test_state_is_kept_where_the_desktop_standard_says(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("ZARM_STATE", raising=False)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert default_state() == tmp_path / "zarm"
    monkeypatch.delenv("XDG_STATE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert default_state() == tmp_path / ".local/state/zarm"
