"""Clients share the planner: one that asks for much, or dies while it is computed, does not keep the others waiting."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from support.harness import PATIENCE, ServiceProcess, eventually
from support.paths import PROGRAMS
from support.planner.client import BEHIND_FENCE, BEHIND_POST, FENCE, HOME, KEYS, POST, load, plan, to_joints
from zarm_contract.codec import encode
from zarm_contract.messages import IkRequest, Message, PlanRequest, Pose, WaypointsGoal
from zarm_planner.service import CAPACITY
from zarm_runtime.bus import Bus

CORES = os.cpu_count() or 1
SHARE = CAPACITY // 2
MODEST = PlanRequest(start=HOME, goal=to_joints(-0.3, *HOME[1:]), timeout=60.0)
ENDLESS = PlanRequest(start=HOME, goal=to_joints(*BEHIND_FENCE), timeout=60.0, max_attempts=1000)
OPTIMIZED = PlanRequest(
    start=HOME,
    goal=WaypointsGoal(kind="waypoints", through=(to_joints(*BEHIND_POST), to_joints(*HOME))),
    timeout=60.0,
    optimize_s=30.0,
)


class Greedy:
    """A process of `greedy_client.py`."""

    def __init__(self, process: subprocess.Popen[bytes], lines: Path) -> None:
        self.process = process
        self._lines = lines

    @property
    def answers(self) -> list[dict[str, object]]:
        """What it has been answered so far."""
        return [json.loads(line) for line in self._lines.read_text().splitlines()]

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()


@contextmanager
def greedy(endpoint: str, folder: Path, key: str, request: Message, count: int) -> Iterator[Greedy]:
    script, lines = PROGRAMS / "greedy_client.py", folder / "answers"
    with lines.open("wb") as out:
        process = subprocess.Popen(
            [sys.executable, script, endpoint, key, str(count)], stdin=subprocess.PIPE, stdout=out
        )
    client = Greedy(process, lines)
    try:
        process.stdin.write(encode(request))
        process.stdin.close()
        yield client
    finally:
        client.kill()


@pytest.fixture(scope="module")
def process(place: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServiceProcess]:
    with ServiceProcess("planner", place, tmp_path_factory.mktemp("planner")) as process:
        with Bus(place) as bus:
            process.wait_ready(bus, KEYS)
        yield process


@pytest.fixture
def modest(process: ServiceProcess, place: str) -> Iterator[Bus]:
    """A client that asks for one thing at a time."""
    with Bus(place) as bus:
        yield bus


def ended(process: ServiceProcess, before: str) -> int:
    """How many plans have been ended before their time since the log was `before`."""
    return process.output().removeprefix(before).count("code=cancelled")


def test_endless_searches_starve_nobody_and_can_be_ended(
    process: ServiceProcess, modest: Bus, place: str, tmp_path: Path
) -> None:
    load(modest, *FENCE)
    before = process.output()
    with greedy(place, tmp_path, KEYS.plan, ENDLESS, SHARE + 1) as client:
        (busy,) = eventually(lambda: client.answers, "it has all of its share in hand, and one request more is refused")
        assert busy["code"] == "busy"
        assert f"{SHARE} pending requests of this client" in str(busy["message"])
        plan(modest, MODEST)
        assert client.answers == [busy]
        client.kill()
    eventually(lambda: ended(process, before) == SHARE, "all that the killed client had in hand has ended")
    plan(modest, MODEST)


def test_optimisation_ends_for_the_requests_of_others(modest: Bus, place: str, tmp_path: Path) -> None:
    load(modest, POST)
    with greedy(place, tmp_path, KEYS.plan, OPTIMIZED, CORES) as client:
        eventually(lambda: [plan(modest, MODEST), *client.answers][1:], "a long optimisation has ended")
        (first, *_) = client.answers
        assert first["code"] == "ok"
        assert float(str(first["optimize"])) < 30.0


def test_optimisation_for_a_killed_client_ends(
    process: ServiceProcess, modest: Bus, place: str, tmp_path: Path
) -> None:
    load(modest, POST)
    before = process.output()
    with greedy(place, tmp_path, KEYS.plan, OPTIMIZED, SHARE) as client:
        eventually(
            lambda: len(client.answers) >= SHARE - CORES, "its last requests, which none of its own waits for, run"
        )
        client.kill()
    left = SHARE - len(client.answers)
    assert left > 0
    eventually(lambda: ended(process, before) == left, "they have ended")
    plan(modest, MODEST)


def test_batches_keep_no_other_client_waiting(modest: Bus, place: str, tmp_path: Path) -> None:
    load(modest)
    far = Pose(position=(3.0, 0.0, 0.5), orientation=(0.0, 0.0, 0.0, 1.0))
    near = IkRequest(poses=(Pose(position=(0.4, -0.4, 0.4), orientation=(1.0, 0.0, 0.0, 0.0)),), near=HOME)
    with greedy(place, tmp_path, KEYS.ik, IkRequest(poses=(far,) * 1000, near=HOME), SHARE + 1) as client:
        eventually(lambda: client.answers, "it has all of its share in hand, and one request more is refused")
        modest.call(KEYS.ik, near, timeout=PATIENCE)
        assert len(client.answers) < SHARE
