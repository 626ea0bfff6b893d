"""The process of the simulated driver."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from support.harness import ServiceProcess
from support.trajectories import KEYS
from support.undriven_panda import undriven_panda
from zarm_runtime.bus import Bus

ASK = "from zarm_runtime.realtime import *; print(ask_for_realtime(PROCESS_PRIORITY))"
WITHOUT_ROS = "import sys; sys.modules['rclpy'] = None; from zarm_leeloo_sim.service import main; sys.exit(main())"


@pytest.mark.parametrize(
    ("robot", "words"),
    [("doosan_m1013", "`make ros` installs it"), ("panda", "write strategy_params into its descriptor")],
)
def test_it_refuses_ros_that_it_cannot_speak(robot: str, words: str, endpoint: str, tmp_path: Path) -> None:
    if robot == "panda":
        robot = str(undriven_panda(tmp_path))
    command = [sys.executable, "-c", WITHOUT_ROS, "--robot", robot, "--connect", endpoint, "--state", str(tmp_path)]
    done = subprocess.run([*command, "--ros"], stderr=subprocess.PIPE, text=True, timeout=60)
    assert done.returncode == 1
    assert words in done.stderr.splitlines()[-1]


@pytest.mark.skipif(not hasattr(os, "sched_getscheduler"), reason="this system knows no real-time priority")
@pytest.mark.parametrize("service", ["executor", "leeloo_sim"])
def test_driver_and_executor_have_real_time_priority(service: str, bus: Bus, endpoint: str, tmp_path: Path) -> None:
    asked = subprocess.run([sys.executable, "-c", ASK], capture_output=True, text=True, check=True)
    wanted = os.SCHED_RR if asked.stdout == "True\n" else os.SCHED_OTHER
    with ServiceProcess(service, endpoint, tmp_path) as process:
        process.wait_ready(bus, KEYS)
        assert os.sched_getscheduler(process.process.pid) == wanted
