"""`zarm execute` at an executor that does not say whether it moves the robot."""

from __future__ import annotations

import signal
import subprocess
import threading
from contextlib import suppress
from pathlib import Path
from queue import Queue

import psutil
import pytest

from support.command_line import KEYS, ROBOT, Command, the_one_line
from support.executor.client import Client
from support.harness import PATIENCE, ServiceProcess, eventually
from support.trajectories import SCENE, moved, plan, rest_to_rest
from zarm_contract.codec import encode
from zarm_contract.errors import Unavailable
from zarm_contract.messages import Accepted, CancelRequest, ExecuteRequest, ExecutorState, SceneEdited
from zarm_runtime.bus import Bus

IDLE = ExecutorState(mode="idle", strategy="emulator", speed_scale=1.0, missed_ticks=0)


def test_ctrl_c_does_not_keep_the_goal_from_being_withdrawn(bus: Bus, endpoint: str, tmp_path: Path) -> None:
    asked: list[ExecuteRequest] = []
    withdrawn: list[CancelRequest] = []
    interrupted = threading.Event()

    def execute(request: ExecuteRequest) -> Accepted:
        asked.append(request)
        command.interrupt()
        interrupted.set()
        raise Unavailable("the answer is lost")

    def cancel(request: CancelRequest) -> ExecutorState:
        with suppress(subprocess.TimeoutExpired):  # whoever does not wait for the answer has ended by then
            command.process.wait(0.5)
        withdrawn.append(request)
        return IDLE

    bus.serve(KEYS.execute, execute)
    bus.serve(KEYS.cancel, cancel)
    bus.declare_alive(KEYS.alive("executor", "1"))
    arguments = ("execute", "--plan-id", "p-1", "--connect", endpoint, "--name", ROBOT)
    with Command(*arguments, folder=tmp_path) as command:
        assert interrupted.wait(PATIENCE)
        assert command.end() == 130
        assert [one.goal_id for one in withdrawn] == [asked[0].goal_id]


def press(command: Command) -> None:
    """Ctrl-C, and wait until the command has seen it and waits on: of two that it sees at once it counts one."""
    seen = psutil.Process(command.process.pid).num_ctx_switches().voluntary
    command.interrupt()
    eventually(
        lambda: (
            command.process.poll() is not None
            or psutil.Process(command.process.pid).num_ctx_switches().voluntary > seen
        ),
        "it has seen Ctrl-C",
    )


def test_insisting_leaves_a_hanging_executor_with_a_warning(
    client: Client, executor: ServiceProcess, endpoint: str, tmp_path: Path
) -> None:
    file = tmp_path / "plan.json"
    file.write_bytes(encode(plan("p-1", rest_to_rest(moved(1.0), slower=10.0))))
    scene = client.bus.latched(KEYS.scene_revision)
    scene.set(SceneEdited(revision=SCENE, count=0))
    arguments = ("execute", "--plan", str(file), "--connect", endpoint, "--name", ROBOT)
    with Command(*arguments, folder=tmp_path) as command:
        (goal_id,) = eventually(lambda: {goal.goal_id for goal in client.goals}, "the goal is known")
        client.under_way(goal_id, 0.1)
        executor.process.send_signal(signal.SIGSTOP)
        press(command)
        assert command.errors() == ""
        press(command)
        eventually(command.errors, "it says what is waited for")
        assert f"waiting for the executor of {ROBOT} to bring the robot to rest" in the_one_line(command.errors())
        press(command)
        assert command.end() == 130
        assert "the state of the robot is unknown" in command.errors().splitlines()[-1]
        executor.process.send_signal(signal.SIGCONT)
        assert client.ended(goal_id).status in ("aborted", "cancelled")
        assert client.stands()


@pytest.mark.slow  # near to the test before
def test_leaving_before_acceptance_withdraws_the_goal(bus: Bus, endpoint: str, tmp_path: Path) -> None:
    asked: Queue[str | None] = Queue()
    withdrawn: Queue[str | None] = Queue()
    may_answer = threading.Event()

    def execute(request: ExecuteRequest) -> Accepted:
        asked.put(request.goal_id)
        may_answer.wait(PATIENCE)
        raise Unavailable("nobody waits for this")

    def cancel(request: CancelRequest) -> ExecutorState:
        withdrawn.put(request.goal_id)
        may_answer.wait(PATIENCE)
        return IDLE

    bus.serve(KEYS.execute, execute)
    bus.serve(KEYS.cancel, cancel)
    arguments = ("execute", "--plan-id", "p-1", "--connect", endpoint, "--name", ROBOT)
    with Command(*arguments, folder=tmp_path) as command:
        goal_id = asked.get(timeout=PATIENCE)
        for _ in range(3):
            press(command)
        assert withdrawn.get(timeout=PATIENCE) == goal_id
        assert command.end() == 130
        first, last = command.errors().splitlines()
        assert "to take the goal or refuse it" in first
        assert "the state of the robot is unknown" in last
    may_answer.set()
