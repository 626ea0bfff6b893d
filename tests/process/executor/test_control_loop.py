"""A control loop that hangs keeps neither the robot nor its process."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from support.executor.driven import THERE, Driven
from support.faults.arena import STEP
from support.harness import PATIENCE, ServiceProcess, eventually
from support.paths import PROGRAMS
from support.trajectories import KEYS
from zarm_contract.errors import Unavailable
from zarm_contract.messages import Nothing
from zarm_runtime.bus import Bus

HANGING = str(PROGRAMS / "hanging_executor.py")


def test_a_hanging_control_loop_ends_the_process(endpoint: str, bus: Bus, tmp_path: Path) -> None:
    hang = tmp_path / "hang"
    arm = Driven(bus, endpoint, tmp_path, "joint_speed")
    with arm.new_driver() as driver:
        driver.wait_ready(bus, KEYS)
        executor = ServiceProcess(
            "executor",
            endpoint,
            tmp_path,
            arguments=("--strategy", "joint_speed"),
            script=HANGING,
            environment={"HANG": str(hang)},
        )
        with executor:
            executor.wait_ready(bus, KEYS)
            arm.client.under_way(arm.client.execute(THERE), 0.2)
            hang.touch()
            said = []

            def ended() -> bool:
                if executor.process.poll() is None:
                    try:
                        said.append(bus.call(KEYS.health("executor"), Nothing(), timeout=1))
                    except Unavailable:
                        return False
                return executor.process.poll() is not None

            eventually(ended, "the process has ended", PATIENCE)
            assert executor.process.returncode == 1
            ill = [health for health in said if not health.ready]
            assert ill
            assert "control loop has not ticked" in ill[-1].activity
            assert "the control loop does not tick" in executor.output()
            assert "in hang" in executor.output()
        arm.at_rest()
        hang.unlink()
        with arm.new_executor() as again:
            again.wait_ready(bus, KEYS)
            assert arm.client.state().mode == "idle"


@pytest.mark.slow
def test_a_process_that_stood_still_as_a_whole_is_not_ended(endpoint: str, bus: Bus, tmp_path: Path) -> None:
    arm = Driven(bus, endpoint, tmp_path, "joint_speed")
    with arm.new_driver() as driver:
        driver.wait_ready(bus, KEYS)
        with arm.new_executor() as executor:
            executor.wait_ready(bus, KEYS)
            os.kill(executor.process.pid, signal.SIGSTOP)
            seen = len(arm.reported)
            eventually(lambda: (len(arm.reported) - seen) * STEP > 4.0, "the executor has stood still for long")
            os.kill(executor.process.pid, signal.SIGCONT)
            assert executor.wait_ready(bus, KEYS).pid == executor.process.pid
            assert arm.client.state().mode == "idle"
