"""`ZARM_SECURITY=on zarm up`: whoever may, drives the robot as before; nobody else moves it or is taken for a service."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path

import pytest
import zenoh

from support.certificates import issue
from support.command_line import HOME, Command, Up, the_one_line, vector, zarm
from support.harness import PATIENCE, eventually, free_endpoint
from support.paths import EXAMPLES, ROOT
from support.tiers import sampled
from support.trajectories import patient
from zarm_cli.certificate_authority import Authority, today
from zarm_contract.codec import encode
from zarm_contract.keys import Keys
from zarm_contract.messages import (
    AddObjects,
    ClearScene,
    DriverCommand,
    ExecuteRequest,
    JointGoal,
    Nothing,
    PlanRequest,
    SceneEdit,
    Speed,
    Sphere,
    StrategyRequest,
)
from zarm_contract.roles import Role
from zarm_runtime.bus import Bus
from zarm_runtime.session import open_client

DOCUMENTATION = ROOT / "docs" / "how-to" / "secure-a-bus.md"
JOINT_NAMES = [f"joint_{number}" for number in range(1, 7)]
BALL = Sphere(kind="sphere", name="ball", position=(0.0, -1.0, 0.2), radius=0.1)
THERE = (0.4, *HOME[1:])


@pytest.fixture(scope="module")
def certified(certificates: Path) -> Iterator[dict[str, str]]:
    """What a process needs to take part; this one has it too."""
    variables = {"ZARM_SECURITY": "on", "ZARM_CERTS": str(certificates)}
    with pytest.MonkeyPatch.context() as patch:
        for name, value in variables.items():
            patch.setenv(name, value)
        yield variables


@pytest.fixture(scope="module")
def up(certified: dict[str, str], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Up]:
    """A robot behind the simulated driver, on a bus with access control."""
    folder = tmp_path_factory.mktemp("up")
    robot = ("--robot", str(patient(folder / "patient")), "--driver", "sim", "--strategy", "joint_speed")
    with Up(free_endpoint(), folder, *robot, **certified) as stack:
        yield stack


@pytest.fixture
def operator(up: Up) -> Iterator[Bus]:
    """A session that may drive the robot."""
    with Bus(up.endpoint) as bus:
        yield bus


def run(up: Up, *arguments: str, **variables: str) -> subprocess.CompletedProcess[str]:
    """A command on that bus, as an operator unless told otherwise."""
    settings = {name: value for name, value in up.variables.items() if name.startswith("ZARM_")}
    return zarm(*arguments, **(settings | {"ZARM_CONNECT": up.endpoint} | variables))


def done(up: Up, *arguments: str, **variables: str) -> str:
    result = run(up, *arguments, **variables)
    assert result.returncode == 0, result.stderr
    return result.stdout


def joints(bus: Bus, up: Up) -> tuple[float, ...]:
    state = bus.latest(up.keys.joint_states).wait(PATIENCE)
    assert state is not None
    return state.position


# -- what is allowed works --


def test_an_operator_plans_and_drives_driver_and_emulator(up: Up, operator: Bus) -> None:
    assert "tls/" in up.output()
    for strategy, goal in (("joint_speed", THERE), ("emulator", HOME), ("joint_speed", HOME)):
        done(up, "strategy", strategy)
        done(up, "plan", "--joints", vector(goal))
        done(up, "execute")
        assert joints(operator, up) == pytest.approx(goal, abs=0.02)


def test_an_operator_changes_scene_and_speed_and_stops_the_robot(up: Up, operator: Bus) -> None:
    done(up, "scene", "add", "sphere", "ball", "--at", "0,-1,0.2", "--radius", "0.1")
    assert [one.name for one in operator.read(up.keys.scene, timeout=5).objects] == ["ball"]
    done(up, "scene", "clear")
    done(up, "speed", "0.5")
    assert operator.read(up.keys.speed, timeout=5).speed_scale == 0.5
    done(up, "speed", "1")
    done(up, "stop")


@pytest.mark.slow  # the right is in test_rules.py
def test_an_operator_streams_from_a_closed_loop_planner(up: Up, tmp_path: Path) -> None:
    done(up, "strategy", "emulator")
    followed = subprocess.run(
        [*example("stream_client.py", "operator", up, tmp_path), "--seconds", "1"], timeout=PATIENCE, check=False
    )
    assert followed.returncode == 0
    done(up, "strategy", "joint_speed")


def test_a_third_party_driver_publishes_joints_by_certificate(up: Up, operator: Bus, tmp_path: Path) -> None:
    reported = operator.latest(Keys("other").driver_joint_states)
    driver = subprocess.Popen(
        [*example("zenoh_driver.py", "driver", up, tmp_path), "--robot", "other", "--at", *map(str, HOME)]
    )
    try:
        eventually(lambda: (state := reported.get()) and state.position == tuple(HOME), "the driver tells its joints")
    finally:
        driver.terminate()
        driver.wait(PATIENCE)


def example(program: str, role: str, up: Up, folder: Path) -> list[str]:
    """An example's command line, with the certificate of `role`."""
    certificates = up.variables["ZARM_CERTS"]
    tls = {
        "root_ca_certificate": f"{certificates}/ca.pem",
        "connect_certificate": f"{certificates}/{role}.pem",
        "connect_private_key": f"{certificates}/{role}.key",
        "enable_mtls": True,
    }
    config = folder / "certified.json5"
    config.write_text(json.dumps({"transport": {"link": {"tls": tls}}}))
    where = ("--connect", up.endpoint.replace("tcp/", "tls/"), "--config", str(config))
    return [sys.executable, str(EXAMPLES / program), *where, "--joints", *JOINT_NAMES]


def test_a_viewer_sees_everything_and_may_stop_the_robot(up: Up, tmp_path: Path) -> None:
    viewer = {"ZARM_ROLE": "viewer"}
    for command in (("status",), ("strategy",), ("speed",), ("check",), ("stop",)):
        done(up, *command, **viewer)
    file = tmp_path / "seen.mcap"
    done(up, "record", str(file), "--seconds", "0.5", "--name", up.keys.robot, **viewer)
    assert "joint_speed" in zarm("replay", str(file)).stdout
    settings = {name: value for name, value in up.variables.items() if name.startswith("ZARM_")}
    with Command("watch", "--json", folder=tmp_path, **settings, **viewer, ZARM_CONNECT=up.endpoint) as watch:
        watch.wait_for('"position"')


def test_the_zenoh_lines_of_the_documentation_work_as_written(up: Up, tmp_path: Path) -> None:
    block = re.search(r"```sh\n(cat > viewer.*?)```", DOCUMENTATION.read_text(), re.DOTALL)
    assert block
    (tmp_path / "certs").symlink_to(up.variables["ZARM_CERTS"])
    lines = block.group(1).replace("tls/workstation:7447", up.endpoint.replace("tcp/", "tls/"))
    path = f"{Path(sys.executable).parent}:{up.variables['PATH']}"
    reported = subprocess.run(
        ["bash", "-c", lines],
        cwd=tmp_path,
        env=up.variables | {"PATH": path},
        capture_output=True,
        text=True,
        timeout=PATIENCE,
    )
    assert json.loads(the_one_line(reported.stdout))["mode"] == "idle", reported.stderr


def test_health_is_answered_with_a_service_s_own_certificate(up: Up, certificates: Path, tmp_path: Path) -> None:
    for name in ("ca.pem", "planner.pem", "planner.key"):
        (tmp_path / name).symlink_to(certificates / name)
    done(up, "health", "planner", ZARM_CERTS=str(tmp_path), ZARM_ROLE="planner")
    refused = run(up, "status", ZARM_ROLE="boss")
    assert refused.returncode == 1
    assert "ZARM_ROLE=boss is not a role" in the_one_line(refused.stderr)


# -- what is not allowed does nothing --


@pytest.mark.parametrize(
    "command",
    sampled(f"execute --joints {vector(THERE)}", f"plan --joints {vector(THERE)}", "speed 0.1", "scene clear"),
)
def test_a_viewer_is_told_at_once_what_it_may_not_do(up: Up, command: str) -> None:
    refused = run(up, *command.split(), ZARM_ROLE="viewer")
    assert refused.returncode == 1
    assert "the role viewer is not allowed to send requests to" in the_one_line(refused.stderr)


@pytest.mark.parametrize("role", sampled("viewer", "planner", "driver", "executor"))
def test_a_client_without_zarm_is_not_answered(up: Up, operator: Bus, role: Role) -> None:
    add = AddObjects(op="add", objects=(BALL,), replace=True)
    operator.call(up.keys.scene_edit, SceneEdit(edit=add), timeout=5)
    operator.call(up.keys.plan, PlanRequest(goal=JointGoal(kind="joints", position=THERE)), timeout=PATIENCE)
    where, scene = joints(operator, up), operator.read(up.keys.scene, timeout=5)
    with open_client(up.endpoint, role=role) as session:
        for key, message in (
            (up.keys.execute, ExecuteRequest()),
            (up.keys.scene_edit, SceneEdit(edit=ClearScene(op="clear"))),
            (up.keys.speed, Speed(speed_scale=0.1)),
            (up.keys.strategy, StrategyRequest(strategy="emulator")),
        ):
            assert not list(session.get(key, payload=encode(message), timeout=PATIENCE))
    state = operator.read(up.keys.executor_state, timeout=5)
    assert (state.mode, state.strategy, state.speed_scale) == ("idle", "joint_speed", 1.0)
    assert operator.read(up.keys.scene, timeout=5) == scene
    assert joints(operator, up) == pytest.approx(where, abs=1e-3)


def test_the_driver_hears_commands_from_the_executor_alone(up: Up, operator: Bus) -> None:
    # By the emulator the executor moves, and commands nothing itself.
    operator.call(up.keys.strategy, StrategyRequest(strategy="emulator"), timeout=PATIENCE)
    reported = operator.latest(up.keys.driver_joint_states)
    state = reported.wait(PATIENCE)
    assert state is not None
    away = tuple(q + 0.5 for q in state.position)
    rest = (0.0,) * len(away)
    command = DriverCommand(
        sequence=1,
        joint_names=state.joint_names,
        based_on=state.stamp,
        expires_after=PATIENCE,
        time=(0.0, 2.0),
        position=(state.position, away),
        velocity=(tuple(0.25 for _ in rest), rest),
        acceleration=(rest, rest),
    )
    roles: tuple[Role, ...] = ("viewer", "planner", "operator", "bridge", "driver")
    for role in roles:
        with open_client(up.endpoint, role=role) as session:
            session.put(up.keys.driver_command, encode(command))
            list(session.get(up.keys.health("leeloo_sim")))  # the driver had both, were both let through
    for _ in range(10):
        after = reported.wait(PATIENCE)
        assert after is not None
        assert after.position == pytest.approx(state.position, abs=1e-3)
    operator.call(up.keys.strategy, StrategyRequest(strategy="joint_speed"), timeout=PATIENCE)


@pytest.mark.parametrize("role", sampled("operator", "viewer"))
def test_nobody_poses_as_the_executor(up: Up, operator: Bus, role: Role) -> None:
    caught: list[str] = []

    def catch(query: zenoh.Query) -> None:
        caught.append(str(query.key_expr))
        query.reply(query.key_expr, b"{}")

    with open_client(up.endpoint, role=role) as session:
        session.declare_queryable(up.keys.stop, catch, complete=True)
        session.liveliness().declare_token(up.keys.alive("executor", "0" * 15))
        list(session.get(up.keys.health("executor")))
        assert operator.call(up.keys.stop, Nothing(), timeout=5).mode == "idle"
        assert len(operator.alive(up.keys.alive("executor", "*"))) == 1
    assert caught == []


def test_a_record_is_not_replayed_in_place_of_an_executor(up: Up, tmp_path: Path) -> None:
    file = tmp_path / "seen.mcap"
    done(up, "record", str(file), "--seconds", "0.2", "--name", up.keys.robot)
    refused = run(up, "replay", str(file), "--publish", "ghost")
    assert refused.returncode == 1
    assert "is not allowed to be alive as" in the_one_line(refused.stderr)


# -- who is not let in --


def tls_client(endpoint: str, **tls: object) -> zenoh.Config:
    config = zenoh.Config()
    settings = {
        "mode": "client",
        "connect/endpoints": [endpoint.replace("tcp/", "tls/")],
        "connect/timeout_ms": 2000,
        "connect/exit_on_failure": True,
        "scouting/multicast/enabled": False,
    } | {f"transport/link/tls/{name}": value for name, value in tls.items()}
    for name, value in settings.items():
        config.insert_json5(name, json.dumps(value))
    return config


def with_certificates(folder: Path, role: str, authority: Path) -> dict[str, object]:
    return {
        "root_ca_certificate": str(authority / "ca.pem"),
        "connect_certificate": str(folder / f"{role}.pem"),
        "connect_private_key": str(folder / f"{role}.key"),
        "enable_mtls": True,
    }


def test_only_a_valid_certificate_of_this_authority_connects(up: Up, certificates: Path, tmp_path: Path) -> None:
    issue(certificates, tmp_path / "ended", "operator", now=today() - timedelta(days=9), lasts=timedelta(days=8))
    stranger = tmp_path / "stranger"
    Authority.make(tmp_path / "stranger-authority", today())
    issue(stranger, stranger, "operator")
    entries = {
        "valid": with_certificates(certificates, "operator", certificates),
        "none": {"root_ca_certificate": str(certificates / "ca.pem")},
        "ended": with_certificates(tmp_path / "ended", "operator", certificates),
        "of another authority": with_certificates(stranger, "operator", certificates),
    }
    let_in = []
    for name, tls in entries.items():
        try:
            with zenoh.open(tls_client(up.endpoint, **tls)) as session:
                if [one for one in session.get(up.keys.executor_state, timeout=5) if one.ok]:
                    let_in.append(name)
        except zenoh.ZError:
            continue
    assert let_in == ["valid"]


def test_a_certificate_for_no_role_of_zarm_allows_nothing(up: Up, certificates: Path, tmp_path: Path) -> None:
    issue(certificates, tmp_path, "janitor")  # type: ignore[arg-type]
    with zenoh.open(tls_client(up.endpoint, **with_certificates(tmp_path, "janitor", certificates))) as session:
        assert not list(session.get(up.keys.executor_state, timeout=5))
        assert not list(session.get(up.keys.stop, timeout=5))


def test_a_client_without_certificates_is_told_what_to_set(up: Up) -> None:
    refused = zarm("status", ZARM_CONNECT=up.endpoint)
    assert refused.returncode == 3
    assert "ZARM_SECURITY=on" in the_one_line(refused.stderr)


@pytest.mark.slow  # that nobody gets in so is above
def test_a_client_of_another_authority_is_told_so(up: Up, tmp_path: Path) -> None:
    assert zarm("certs", str(tmp_path / "certs")).returncode == 0
    refused = run(up, "status", ZARM_CERTS=str(tmp_path / "certs"))
    assert refused.returncode == 3
    assert "of one authority" in the_one_line(refused.stderr)


@pytest.mark.slow  # the reason is in test_certs.py
def test_a_service_with_an_expired_certificate_ends_and_says_so(up: Up, certificates: Path, tmp_path: Path) -> None:
    issue(certificates, tmp_path, "planner", now=today() - timedelta(days=9), lasts=timedelta(days=8))
    settings = {name: value for name, value in up.variables.items() if name.startswith("ZARM_")}
    command = [sys.executable, "-m", "zarm_planner.service", "--connect", up.endpoint, "--name", "other"]
    ended = subprocess.run(
        command,
        env=up.variables | settings | {"ZARM_CERTS": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=PATIENCE,
    )
    assert ended.returncode == 1
    assert "planner.pem has ended" in ended.stderr


def test_a_router_that_a_name_does_not_belong_to_is_not_trusted(certified: dict[str, str], tmp_path: Path) -> None:
    issue(Path(certified["ZARM_CERTS"]), tmp_path, "router", hosts=["elsewhere"])
    issue(Path(certified["ZARM_CERTS"]), tmp_path, "operator")
    endpoint = free_endpoint()
    with Command(
        "router", "--listen", endpoint, folder=tmp_path, **(certified | {"ZARM_CERTS": str(tmp_path)})
    ) as router:
        router.wait_for("Ctrl-C")
        refused = zarm("status", **certified, ZARM_CONNECT=endpoint)
        assert refused.returncode == 3
        assert "--host 127.0.0.1" in the_one_line(refused.stderr)
