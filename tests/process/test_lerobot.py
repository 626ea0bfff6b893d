"""LeRobot's own classes move a robot of zarm: real planner, executor and servo, and the real lerobot package in a process of its own."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import pytest

import zarm
from support.command_line import environment
from support.harness import PATIENCE, ServiceProcess, router
from support.paths import PROGRAMS
from zarm_contract.keys import Keys
from zarm_contract.messages import JointState
from zarm_contract.robot import load_robot
from zarm_runtime.bus import Bus

pytest.importorskip("lerobot", reason="lerobot is not installed")

KEYS = Keys("panda")
PANDA = load_robot("panda").descriptor
NAMES = [f"{part}.pos" for part in (*PANDA.joints, *PANDA.grippers)]


@contextmanager
def images(robot: zarm.Robot) -> Iterator[None]:
    """Orange images of a camera, ten times a second."""
    ended = threading.Event()

    def publish() -> None:
        while not ended.wait(0.1):
            robot.perception.publish_color("front", time.time(), np.full((48, 64, 3), (200, 100, 0), np.uint8))

    camera = threading.Thread(target=publish)
    camera.start()
    try:
        yield
    finally:
        ended.set()
        camera.join()


def test_a_policy_of_lerobot_moves_the_arm_and_its_gripper(tmp_path: Path) -> None:
    with ExitStack() as stack:
        endpoint = stack.enter_context(router())
        bus = stack.enter_context(Bus(endpoint))
        for service in ("planner", "executor", "servo"):
            stack.enter_context(ServiceProcess(service, endpoint, tmp_path, robot="panda")).wait_ready(bus, KEYS)
        robot = stack.enter_context(zarm.connect(endpoint, "panda"))
        measured: list[JointState] = []
        bus.subscribe(KEYS.joint_states, lambda _, state: measured.append(state))
        stack.enter_context(images(robot))
        ended = subprocess.run(
            [sys.executable, str(PROGRAMS / "lerobot_policy.py"), endpoint, "4"],
            capture_output=True,
            text=True,
            timeout=PATIENCE,
            check=False,
            env=environment(HF_LEROBOT_HOME=str(tmp_path)),
        )
        assert ended.returncode == 0, ended.stderr
        width = robot.gripper.state().width
        rests = not any(robot.joint_state().velocity)
    told = json.loads(ended.stdout.splitlines()[-1])
    assert told["type"] == "zarm"
    assert told["features"] == [[*NAMES, "front"], NAMES]
    assert told["image"] == [[48, 64, 3], [200, 100, 0], [48, 64, 3]]
    assert sorted(told["before"]) == sorted(told["sent"]) == sorted(told["observed"]) == sorted(NAMES)
    turned = np.array([state.position for state in measured])
    assert np.ptp(turned[:, 0]) == pytest.approx(0.2, abs=0.02)
    assert width == pytest.approx(0.04, abs=0.003)
    assert told["sent"]["panda_joint2.pos"] == pytest.approx(load_robot("panda").upper[1])  # 100 rad were asked for
    assert told["refused"].startswith("the action has no panda_joint2.pos")
    assert told["moved"] == pytest.approx(0.0, abs=1e-6), "somebody else moves it"
    assert rests  # the program has left
