"""A client that knows no faults, like those written for curobo_ros: it moves a robot through the poses of a
calibration.
"""

from __future__ import annotations

import random
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from curobo_msgs.srv import TrajectoryGeneration
from support.harness import eventually
from support.ros.goals import HOME, SUCCEEDED, Actions
from support.ros.stack import stack

POSES = 17


def calibrate(folder: Path, strategy: str, *, busy: int, seed: int = 17) -> str:
    """Why not every pose was reached, with `busy` processes that never rest beside it; empty if all were."""
    chance = random.Random(seed)
    with stack(folder, executor=("--strategy", strategy), leeloo_sim=("--ros",)) as running:
        bridge, actions = running.processes["ros_bridge"], Actions(running.ros.node, "send_trajectory")
        eventually(lambda: "a driver has come" in bridge.output(), "its commands would reach the driver")
        with _busy_machine(busy):
            for pose in range(1, POSES + 1):
                joints = [at + chance.uniform(-0.2, 0.2) for at in HOME]
                planned = running.ros.call(TrajectoryGeneration, "generate_trajectory", target_joint_positions=joints)
                if not planned.success:
                    return f"pose {pose} of {POSES}: {planned.message}"
                status, result = actions.send().ended()
                if status != SUCCEEDED:
                    return f"pose {pose} of {POSES}: {result.message}"
    return ""


@contextmanager
def _busy_machine(count: int) -> Iterator[None]:
    processes = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()
