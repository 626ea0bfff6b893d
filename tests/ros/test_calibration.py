"""A client that knows no faults, as those that were written for curobo_ros: it takes a robot through the poses of a calibration."""

from __future__ import annotations

import random
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from curobo_msgs.srv import TrajectoryGeneration
from support.harness import eventually
from support.ros.goals import HOME, SUCCEEDED, Actions
from support.ros.stack import stack

POSES = 17
BUSY = 4
"""Processes beside zarm that never rest."""


@contextmanager
def busy_machine() -> Iterator[None]:
    processes = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(BUSY)]
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()


@pytest.mark.slow
@pytest.mark.parametrize("strategy", ["joint_speed", "joint_trajectory"])
def test_every_pose_of_a_calibration_is_reached_on_a_busy_machine(tmp_path: Path, strategy: str) -> None:
    chance = random.Random(17)
    with stack(tmp_path, executor=("--strategy", strategy), leeloo_sim=("--ros",)) as running:
        bridge, actions = running.processes["ros_bridge"], Actions(running.ros.node, "send_trajectory")
        eventually(lambda: "a driver has come" in bridge.output(), "its commands would reach the driver")
        with busy_machine():
            for pose in range(1, POSES + 1):
                joints = [at + chance.uniform(-0.2, 0.2) for at in HOME]
                planned = running.ros.call(TrajectoryGeneration, "generate_trajectory", target_joint_positions=joints)
                assert planned.success, f"pose {pose}: {planned.message}"
                status, result = actions.send().ended()
                assert status == SUCCEEDED, f"pose {pose} of {POSES}: {result.message}"
