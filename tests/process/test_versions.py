"""Services of different versions, and with different robots, on one bus: who sees it, and what it does."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh

from support.command_line import KEYS, zarm
from support.harness import PATIENCE, ServiceProcess, eventually, router
from support.paths import PROGRAMS
from support.trajectories import descriptor_at, moved, rest_to_rest
from zarm_contract.codec import CONTRACT
from zarm_contract.errors import ExecutionRefused, InternalError, InvalidRequest
from zarm_contract.messages import (
    ExecuteRequest,
    Health,
    JointGoal,
    JointState,
    PlanRequest,
)
from zarm_runtime.bus import Bus
from zarm_runtime.service import version
from zarm_runtime.session import open_client

GOAL = tuple(moved(0.3).tolist())


def other(contract: str = CONTRACT) -> dict[str, str]:
    """The environment of a process of another zarm."""
    folder = str(PROGRAMS / "other_version")
    path = os.pathsep.join(filter(None, (folder, os.environ.get("PYTHONPATH"))))
    return {"PYTHONPATH": path, "ZARM_TEST_VERSION": "9.0.0", "ZARM_TEST_CONTRACT": contract}


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    """The router of the planner that most of these tests share."""
    with router() as address:
        yield address


@pytest.fixture(scope="module")
def planner(endpoint: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServiceProcess]:
    with Bus(endpoint) as bus, ServiceProcess("planner", endpoint, tmp_path_factory.mktemp("planner")) as process:
        process.wait_ready(bus, KEYS)
        yield process
        assert process.process.poll() is None


def executor_of(endpoint: str, folder: Path, contract: str) -> ServiceProcess:
    return ServiceProcess("executor", endpoint, folder, environment=other(contract))


def status(endpoint: str, code: int) -> tuple[dict, str]:
    result = zarm("status", "--json", ZARM_CONNECT=endpoint)
    assert result.returncode == code, result.stderr
    return json.loads(result.stdout), result.stderr


def test_services_that_fit_together_are_shown_with_what_they_are(
    planner: ServiceProcess, executor: ServiceProcess, endpoint: str
) -> None:
    shown, errors = status(endpoint, 0)
    assert shown["mismatches"] == []
    assert errors == ""
    assert shown["client"] == {"version": version(), "contract": CONTRACT}
    table = zarm("status", ZARM_CONNECT=endpoint).stdout
    for service in ("planner", "executor"):
        row = next(line for line in table.splitlines() if line.strip().startswith(service))
        for field in ("version", "contract", "robot_hash"):
            assert shown["services"][service][field] in row


def test_another_version_with_the_same_contract_works(
    planner: ServiceProcess, endpoint: str, bus: Bus, tmp_path: Path
) -> None:
    with executor_of(endpoint, tmp_path, CONTRACT) as executor:
        executor.wait_ready(bus, KEYS)
        shown, errors = status(endpoint, 0)
        (fault,) = shown["mismatches"]
        assert fault["kind"] == "version"
        assert f"9.0.0 by executor, {version()} by planner and this command" in fault["message"]
        assert errors == ""
        bus.call(KEYS.plan, PlanRequest(goal=JointGoal(kind="joints", position=GOAL)), timeout=PATIENCE)
        assert bus.call(KEYS.execute, ExecuteRequest(), timeout=PATIENCE).goal_id


def test_another_contract_is_refused_on_both_sides(
    planner: ServiceProcess, endpoint: str, bus: Bus, tmp_path: Path
) -> None:
    with executor_of(endpoint, tmp_path, "v5") as executor:
        executor.wait_ready(bus, KEYS)
        remedy = "run the same version of zarm on both sides"
        with pytest.raises(InvalidRequest, match=f"of contract {CONTRACT}, and .* speaks v5; {remedy}"):
            bus.call(KEYS.execute, ExecuteRequest(trajectory=rest_to_rest(moved(0.1))), timeout=PATIENCE)
        with pytest.raises(InternalError, match=f"speaks contract v5, and this client {CONTRACT}; {remedy}"):
            bus.read(KEYS.executor_state, timeout=PATIENCE)
        shown, errors = status(endpoint, 1)
        assert {fault["kind"] for fault in shown["mismatches"]} == {"contract", "version"}
        assert "v5 by executor, v4 by planner and this command" in errors
        assert shown["executor"] is None
        assert "contract: " in zarm("status", ZARM_CONNECT=endpoint).stdout
        executed = zarm("execute", "--joints", ",".join(map(str, GOAL)), ZARM_CONNECT=endpoint)
        assert executed.returncode == 1
        assert "no joint state" in executed.stderr or remedy in executed.stderr


def test_a_stop_is_taken_from_a_client_of_any_contract(executor: ServiceProcess, endpoint: str, bus: Bus) -> None:
    encoding = zenoh.Encoding.APPLICATION_JSON.with_schema("zarm.Nothing.v5")
    with open_client(endpoint) as session:
        (reply,) = session.get(KEYS.stop, payload=b"{}", encoding=encoding, timeout=PATIENCE)
        assert reply.ok is not None
        (refused,) = session.get(
            KEYS.speed,
            payload=b"{}",
            encoding=zenoh.Encoding.APPLICATION_JSON.with_schema("zarm.SpeedRequest.v5"),
            timeout=PATIENCE,
        )
        assert refused.err is not None
        assert b"of contract v5" in refused.err.payload.to_bytes()


def test_a_publication_of_another_contract_is_not_taken(planner: ServiceProcess, endpoint: str, bus: Bus) -> None:
    joints = JointState(
        stamp=1.0, joint_names=tuple(f"joint_{k}" for k in range(1, 7)), position=GOAL, velocity=(0.0,) * 6
    )
    newest = bus.latest(KEYS.joint_states)
    with open_client(endpoint) as session:
        for contract, content in (("v5", joints), ("v4", joints.model_copy(update={"stamp": 2.0}))):
            encoding = zenoh.Encoding.APPLICATION_JSON.with_schema(f"zarm.JointState.{contract}")
            session.put(KEYS.joint_states, content.model_dump_json(), encoding=encoding)
        got = eventually(newest.get, "one arrives")
    assert got.stamp == 2.0
    assert "contract=v5 here=v4" in planner.output()


def test_the_health_of_a_later_version_is_read_whatever_it_adds() -> None:
    reported = {
        "service": "planner", "robot": "arm", "instance": "a", "ready": True, "activity": "serving", "version": "9.0.0",
        "contract": "v5", "robot_hash": "0", "uptime": 1.0, "pid": 7, "what_v5_adds": [1],
    }  # fmt: skip
    assert Health.model_validate_json(json.dumps(reported)).version == "9.0.0"


def test_different_files_of_one_robot_prevent_execution(
    planner: ServiceProcess, endpoint: str, bus: Bus, tmp_path: Path
) -> None:
    robot = str(descriptor_at(250, tmp_path / "other"))
    with ServiceProcess("executor", endpoint, tmp_path, robot=robot) as executor:
        there = executor.wait_ready(bus, KEYS).robot_hash
        shown, errors = status(endpoint, 1)
        (fault,) = shown["mismatches"]
        assert fault["kind"] == "robot"
        assert f"{there} by executor" in fault["message"]
        assert "zarm: mismatch: the services have different files of the robot" in errors
        made = bus.call(KEYS.plan, PlanRequest(goal=JointGoal(kind="joints", position=GOAL)), timeout=PATIENCE)
        with pytest.raises(ExecutionRefused, match="another description of this robot"):
            bus.call(KEYS.execute, ExecuteRequest(plan_id=made.plan_id), timeout=PATIENCE)
