"""`zarm execute` at an executor that does not say whether it moves the robot."""

from __future__ import annotations

import subprocess
import threading
from contextlib import suppress
from pathlib import Path

from harness import PATIENCE
from launched import KEYS, ROBOT, Command

from zarm_contract.bus import Bus
from zarm_contract.errors import Unavailable
from zarm_contract.messages import Accepted, CancelRequest, ExecuteRequest, ExecutorState

IDLE = ExecutorState(mode="idle", strategy="emulator", speed_scale=1.0, missed_ticks=0)


def test_ctrl_c_meanwhile_does_not_keep_the_goal_from_being_withdrawn_by_its_name(
    bus: Bus, endpoint: str, tmp_path: Path
) -> None:
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

    bus.serve(KEYS.execute, ExecuteRequest, execute)
    bus.serve(KEYS.cancel, CancelRequest, cancel)
    bus.declare_alive(KEYS.alive("executor", "1"))
    arguments = ("execute", "--plan-id", "p-1", "--connect", endpoint, "--name", ROBOT)
    with Command(*arguments, folder=tmp_path) as command:
        assert interrupted.wait(PATIENCE)
        assert command.end() == 130
        assert [one.goal_id for one in withdrawn] == [asked[0].goal_id]
