"""What Prometheus reads from running services, over HTTP; off unless asked for."""

from __future__ import annotations

import socket
import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families

from support.command_line import Up, refused
from support.executor.client import Client
from support.harness import PATIENCE, ServiceProcess, eventually, free_endpoint
from support.trajectories import HOME, KEYS, moved, rest_to_rest
from zarm_contract.errors import ZarmError
from zarm_contract.messages import JointGoal, PlanRequest
from zarm_runtime.bus import Bus
from zarm_runtime.metrics import serve_metrics

ROBOT = KEYS.robot
SLOW = rest_to_rest(moved(0.8), slower=3.0)


class Scraped(dict[str, float]):
    """Samples by `name{label="value",...}`, without the robot's label, which they must all have."""

    def __init__(self, address: str) -> None:
        with urllib.request.urlopen(f"http://{address}/metrics", timeout=PATIENCE) as reply:
            families = list(text_string_to_metric_families(reply.read().decode()))
        assert len({family.name for family in families}) == len(families)
        for family in families:
            assert family.documentation
            for sample in family.samples:
                labels = dict(sample.labels)
                if sample.name.startswith("zarm_"):
                    assert labels.pop("robot") == ROBOT
                inside = ",".join(f'{name}="{labels[name]}"' for name in sorted(labels))
                self[sample.name + (f"{{{inside}}}" if inside else "")] = sample.value


def free_address() -> str:
    return free_endpoint().removeprefix("tcp/")


@contextmanager
def metered(service: str, endpoint: str, folder: Path, *arguments: str) -> Iterator[tuple[ServiceProcess, str]]:
    where = free_address()
    with ServiceProcess(service, endpoint, folder, arguments=("--metrics", where, *arguments)) as process:
        yield process, where
        process.process.terminate()
        assert process.process.wait(PATIENCE) == 0
    with pytest.raises(OSError, match="refused"):
        Scraped(where)


def test_plans_their_times_and_query_answers_are_counted(endpoint: str, bus: Bus, tmp_path: Path) -> None:
    with metered("planner", endpoint, tmp_path) as (process, where):
        health = process.wait_ready(bus, KEYS)

        def plan(*joints: float) -> None:
            request = PlanRequest(start=tuple(HOME), goal=JointGoal(kind="joints", position=joints))
            bus.call(KEYS.plan, request, timeout=PATIENCE)

        for distance in (0.2, 0.4):
            plan(*moved(distance))
        with pytest.raises(ZarmError):
            plan(*moved(100.0))
        refused = 'zarm_queries_total{key="planner/plan",outcome="invalid_request"}'
        seen = eventually(lambda: refused in (s := Scraped(where)) and s, "the last answer is counted")
        assert seen['zarm_plans_total{outcome="ok",planner="joint_space"}'] == 2
        assert seen['zarm_plans_total{outcome="invalid_request",planner="joint_space"}'] == 1
        assert seen['zarm_planning_seconds_count{planner="joint_space"}'] == 2
        assert 0 < seen['zarm_planning_seconds_sum{planner="joint_space"}'] < PATIENCE
        assert seen['zarm_queries_total{key="planner/plan",outcome="ok"}'] == 2
        assert seen[refused] == 1
        assert seen["zarm_ready"] == seen["zarm_connected"] == 1
        info = f'contract="{health.contract}",robot_hash="{health.robot_hash}",service="planner",version="{health.version}"'
        assert seen[f"zarm_service_info{{{info}}}"] == 1
        assert seen["process_resident_memory_bytes"] > 1e7


def test_goals_faults_ticks_and_joint_age_are_exported(endpoint: str, bus: Bus, tmp_path: Path) -> None:
    with (
        ServiceProcess("leeloo_sim", endpoint, tmp_path) as driver,
        metered("executor", endpoint, tmp_path, "--strategy", "joint_speed") as (process, where),
    ):
        process.wait_ready(bus, KEYS)
        client = Client(bus)
        before = Scraped(where)
        assert before['zarm_faults_total{code="driver_stalled"}'] == 0
        assert before['zarm_goals_total{status="succeeded"}'] == 0
        assert 0 <= before["zarm_joint_state_age_seconds"] < PATIENCE
        assert client.ended(client.execute(rest_to_rest(moved(0.05)))).status == "succeeded"
        goal = client.execute(rest_to_rest(moved(0.8), moved(0.05), slower=3.0))
        client.under_way(goal, 0.1)
        driver.kill()
        client.mode("fault")
        after = eventually(
            lambda: (s := Scraped(where))['zarm_faults_total{code="driver_stalled"}'] and s, "it is counted"
        )
        assert after['zarm_goals_total{status="succeeded"}'] == 1
        assert after['zarm_goals_total{status="aborted"}'] == 1
        assert after["zarm_ticks_missed_total"] == client.state().missed_ticks
        ticks = "zarm_tick_lateness_seconds_count"
        assert after[ticks] > before[ticks] > 0
        assert after['zarm_tick_lateness_seconds_bucket{le="+Inf"}'] == after[ticks]
        rising = [value for name, value in after.items() if name.startswith("zarm_tick_lateness_seconds_bucket")]
        assert rising == sorted(rising)


@pytest.mark.slow
def test_an_unusable_metrics_address_ends_the_service(endpoint: str, bus: Bus, tmp_path: Path) -> None:
    with metered("executor", endpoint, tmp_path) as (first, where):
        first.wait_ready(bus, KEYS)
        for wrong, reason in ((where, "cannot serve metrics at"), ("here", "is not an address for metrics")):
            with ServiceProcess("planner", endpoint, tmp_path, arguments=("--metrics", wrong)) as second:
                assert second.process.wait(PATIENCE) == 1
                assert reason in second.output()
                assert "--metrics" in second.output()
                assert "Traceback" not in second.output()


def test_robots_of_one_process_have_labels_in_metrics() -> None:
    where = free_address()
    with serve_metrics(where) as metrics_of:
        for robot, age in (("left", 1.0), ("right", None)):
            metrics = metrics_of(robot)
            metrics.count("a", "Counted.", 2, code="x")
            metrics.read("gauge", "b", "Read.", lambda age=age: age)
            metrics.read_histogram("c", "Read as a histogram.", (0.1, 1.0), lambda: ([1, 2, 3], 7.5))
        with urllib.request.urlopen(f"http://{where}/metrics", timeout=PATIENCE) as reply:
            families = list(text_string_to_metric_families(reply.read().decode()))
    assert len({family.name for family in families}) == len(families)
    seen = {(s.name, s.labels.get("robot"), s.labels.get("le")): s.value for family in families for s in family.samples}
    for robot in ("left", "right"):
        assert seen["a_total", robot, None] == 2
        assert [seen["c_bucket", robot, le] for le in ("0.1", "1.0", "+Inf")] == [1, 3, 6]
        assert (seen["c_count", robot, None], seen["c_sum", robot, None]) == (6, 7.5)
    assert seen["b", "left", None] == 1.0
    assert ("b", "right", None) not in seen


@pytest.mark.slow  # what is measured is promised above
def test_the_library_is_loaded_only_where_metrics_are_asked_for() -> None:
    program = (
        "import sys, zarm_planner.service, zarm_executor.service\n"
        "from zarm_runtime.metrics import serve_metrics\n"
        "with serve_metrics({}) as of: of('arm').count('a', 'b')\n"
        "print('prometheus_client' in sys.modules)"
    )
    for where, loaded in ((None, "False"), (free_address(), "True")):
        done = subprocess.run(
            [sys.executable, "-c", program.format(repr(where))], capture_output=True, text=True, check=True
        )
        assert done.stdout.split() == [loaded]


def test_without_the_library_a_service_says_how_to_get_it(endpoint: str, tmp_path: Path) -> None:
    hidden = tmp_path / "hidden.py"
    hidden.write_text(
        "import sys; sys.modules['prometheus_client'] = None; from zarm_executor.service import main; sys.exit(main())"
    )
    arguments = ("--metrics", free_address())
    with ServiceProcess("executor", endpoint, tmp_path, script=str(hidden), arguments=arguments) as process:
        assert process.process.wait(PATIENCE) == 1
        assert "pip install 'zarm[metrics]'" in process.output()


def free_neighbours() -> tuple[str, str]:
    """Two addresses of loopback with successive ports that were free a moment ago."""

    def both() -> tuple[str, str] | None:
        host, _, port = free_address().rpartition(":")
        try:
            with socket.create_server((host, int(port) + 1)):
                return f"{host}:{port}", f"{host}:{int(port) + 1}"
        except OSError:
            return None

    return eventually(both, "two ports are free")


@pytest.mark.slow
def test_up_gives_each_service_a_port_of_its_own(tmp_path: Path) -> None:
    first, second = free_neighbours()
    with Up(free_endpoint(), tmp_path, ZARM_METRICS=first) as up:
        for where, service in ((first, "planner"), (second, "executor")):
            assert any(f'service="{service}"' in name for name in Scraped(where))
        assert "not an address" in refused(up, "up", "--metrics", "here", "--name", "other")
