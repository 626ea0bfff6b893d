"""What `zarm up` promises when a process dies."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import psutil
import pytest

from support.command_line import KEYS, Command, Up, pid, wait_replaced, zarm
from support.harness import eventually, free_endpoint
from zarm_contract.messages import GoalState
from zarm_runtime.bus import Bus


@pytest.fixture(scope="module")
def up(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Up]:
    """A stack whose services may be killed, as they come back; the last test kills it. What it cannot clean up any more
    lies in a folder of its own.
    """
    with (
        TemporaryDirectory() as temporary,
        Up(free_endpoint(), tmp_path_factory.mktemp("up"), TMPDIR=temporary) as stack,
    ):
        yield stack


def test_a_killed_planner_comes_back_with_its_scene(up: Up) -> None:
    added = zarm(
        "scene", "add", "cuboid", "shelf", "--at", "0,-1.2,0.2", "--size", "0.2,0.2,0.2", ZARM_CONNECT=up.endpoint
    )
    assert added.returncode == 0, added.stderr
    with Bus(up.endpoint) as bus:
        scene = bus.read(KEYS.scene, timeout=5)
        executor, old = pid(bus, "executor"), pid(bus, "planner")
        os.kill(old, signal.SIGKILL)
        new = wait_replaced(bus, "planner", old)
        assert bus.read(KEYS.scene, timeout=5).objects == scene.objects
        assert pid(bus, "executor") == executor
    status = json.loads(zarm("status", "--json", ZARM_CONNECT=up.endpoint).stdout)
    assert status["services"]["planner"]["pid"] == new.pid


@pytest.mark.slow
def test_an_executor_killed_in_motion_restarts_idle_in_place(up: Up, tmp_path: Path) -> None:
    with Bus(up.endpoint) as bus:
        old = pid(bus, "executor")
        joints = bus.latest(KEYS.joint_states)
        goals: list[GoalState] = []
        bus.subscribe(KEYS.goal("*"), lambda _, goal: goals.append(goal))
        arguments = ("execute", "--joints", "1.2,0,1.57,0,1.57,0", "--velocity-scale", "0.3", "--connect", up.endpoint)
        with Command(*arguments, folder=tmp_path) as execute:
            eventually(lambda: goals and goals[-1].progress > 0.2, "the robot is on its way")
            moving = joints.get()
            os.kill(old, signal.SIGKILL)
            assert execute.end() in (1, 3)
            assert execute.errors().startswith("zarm: ")
        wait_replaced(bus, "executor", old)
        assert bus.read(KEYS.executor_state, timeout=5).mode == "idle"
        resting = joints.wait(5)
        assert moving is not None
        assert resting is not None
        assert resting.velocity == (0.0,) * 6
        assert 0.05 < resting.position[0] < 1.15
        assert resting.position[0] == pytest.approx(moving.position[0], abs=0.5)


@pytest.mark.slow
def test_up_ends_with_a_sentence_when_its_supervisor_is_killed(tmp_path: Path) -> None:
    with Up(free_endpoint(), tmp_path) as doomed:
        supervisor = psutil.Process(doomed.process.pid).children()
        assert len(supervisor) == 1
        supervisor[0].kill()
        assert doomed.end() == 1
        assert doomed.errors().splitlines()[-1].startswith("zarm: internal: supervisord ended")
        eventually(lambda: not doomed.family(), "every process of the launcher is gone")


def test_no_process_outlives_a_killed_launcher(up: Up) -> None:
    assert up.family()
    up.process.kill()
    eventually(lambda: not up.family(), "every process of the launcher is gone")
