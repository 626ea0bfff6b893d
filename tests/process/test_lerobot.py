"""LeRobot's own classes move a robot of zarm: real planner, executor and servo, and the real lerobot package in a process of its own."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import zarm
from support.command_line import environment
from support.harness import PATIENCE, ServiceProcess, router
from support.paths import PROGRAMS
from zarm_contract.codec import encode
from zarm_contract.keys import Keys
from zarm_contract.messages import JointState
from zarm_contract.robot import load_robot
from zarm_runtime.bus import Bus
from zarm_runtime.record import RecordFile

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


@dataclass(frozen=True)
class Followed:
    """What a policy of LeRobot said, what was measured meanwhile, and its record."""

    told: dict[str, Any]
    measured: list[JointState]
    width: float | None
    rests: bool
    record: Path


def program(name: str, *arguments: str, home: Path) -> subprocess.CompletedProcess[str]:
    """A program with LeRobot, once it has ended."""
    return subprocess.run(
        [sys.executable, str(PROGRAMS / name), *arguments],
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
        env=environment(HF_LEROBOT_HOME=str(home), HF_HUB_OFFLINE="1"),
    )


def run(name: str, *arguments: str, home: Path) -> str:
    """What a program with LeRobot prints."""
    ended = program(name, *arguments, home=home)
    assert ended.returncode == 0, ended.stderr
    return ended.stdout


@pytest.fixture(scope="module")
def followed(tmp_path_factory: pytest.TempPathFactory) -> Followed:
    folder = tmp_path_factory.mktemp("lerobot")
    with ExitStack() as stack:
        endpoint = stack.enter_context(router())
        bus = stack.enter_context(Bus(endpoint))
        for service in ("planner", "executor", "servo"):
            stack.enter_context(ServiceProcess(service, endpoint, folder, robot="panda")).wait_ready(bus, KEYS)
        robot = stack.enter_context(zarm.connect(endpoint, "panda"))
        measured: list[JointState] = []
        bus.subscribe(KEYS.joint_states, lambda _, state: measured.append(state))
        stack.enter_context(images(robot))
        with robot.record(folder / "pick.mcap", images=True) as recorder:
            printed = run("lerobot_policy.py", endpoint, "4", home=folder)
        told = json.loads(printed.splitlines()[-1])
        width, rests = robot.gripper.state().width, not any(robot.joint_state().velocity)
    return Followed(told, measured, width, rests, recorder.path)


def test_a_policy_of_lerobot_moves_the_arm_and_its_gripper(followed: Followed) -> None:
    told = followed.told
    assert told["type"] == "zarm"
    assert told["features"] == [[*NAMES, "front"], NAMES]
    assert told["image"] == [[48, 64, 3], [200, 100, 0], [48, 64, 3]]
    assert sorted(told["before"]) == sorted(told["sent"]) == sorted(told["observed"]) == sorted(NAMES)
    turned = np.array([state.position for state in followed.measured])
    assert np.ptp(turned[:, 0]) == pytest.approx(0.2, abs=0.02)
    assert followed.width == pytest.approx(0.04, abs=0.003)
    assert told["sent"]["panda_joint2.pos"] == pytest.approx(load_robot("panda").upper[1])  # 100 rad were asked for
    assert told["refused"].startswith("the action has no panda_joint2.pos")
    assert told["moved"] == pytest.approx(0.0, abs=1e-6), "somebody else moves it"
    assert followed.rests  # the program has left


def test_records_become_a_data_set_of_lerobot(followed: Followed, tmp_path: Path) -> None:
    import av
    import pandas

    record, root = str(followed.record), tmp_path / "set"
    options = ("--repo-id", "me/pick", "--task", "Pick the cube", "--fps", "20", "--root", str(root))
    assert "2 episodes" in run("zarm_to_lerobot.py", record, record, *options, home=tmp_path)
    info = json.loads((root / "meta" / "info.json").read_text())
    assert (info["total_episodes"], info["fps"], info["robot_type"]) == (2, 20, "zarm")
    assert info["features"]["action"]["names"] == info["features"]["observation.state"]["names"] == NAMES
    frames = pandas.read_parquet(root / "data")
    assert list(pandas.read_parquet(root / "meta" / "tasks.parquet").index) == ["Pick the cube"]
    for _, episode in frames.groupby("episode_index"):
        observed, acted = np.stack(episode["observation.state"]), np.stack(episode["action"])
        assert np.array_equal(acted[:-1], observed[1:])
        assert np.ptp(observed[:, 0]) == pytest.approx(0.2, abs=0.02)
        assert observed[-1, -1] == pytest.approx(0.04, abs=0.003)
        positions = np.array([state.position for state in followed.measured], np.float32)
        assert np.abs(observed[::10, None, :-1] - positions).max(axis=2).min(axis=1).max() < 1e-6  # each was measured
    [film] = (root / "videos" / "observation.images.front").rglob("*.mp4")
    with av.open(str(film)) as container:
        pictures = [picture.to_ndarray(format="rgb24") for picture in container.decode(video=0)]
    assert len(pictures) == len(frames)
    assert np.abs(np.mean(pictures, axis=(0, 1, 2)) - (200, 100, 0)).max() < 10


@pytest.mark.parametrize(
    ("stamps", "with_another", "refused"),
    [
        ((0.0, 0.5, 1.0), True, "other joints, grippers, cameras"),
        ((0.0, 0.1, 2.0), False, "no zarm/panda/joint_states for more than a second"),
        ((), False, "has no joints of panda"),
    ],
)
def test_a_data_set_is_made_whole_or_not_at_all(
    followed: Followed, tmp_path: Path, stamps: tuple[float, ...], with_another: bool, refused: str
) -> None:
    file = RecordFile(tmp_path / "other.mcap", KEYS)
    file.write((0, KEYS.strategy, b"{}"))
    for stamp in stamps:
        zeros = (0.0,) * len(PANDA.joints)
        state = JointState(stamp=stamp, joint_names=PANDA.joints, position=zeros, velocity=zeros)
        file.write((int(1e9 * (1.0 + stamp)), KEYS.joint_states, encode(state)))
    file.close()
    records = (str(followed.record), str(file.path)) if with_another else (str(file.path),)
    options = ("--repo-id", "me/pick", "--task", "Pick", "--root", str(tmp_path / "set"))
    ended = program("zarm_to_lerobot.py", *records, *options, home=tmp_path)
    assert ended.returncode == 2
    assert refused in " ".join(ended.stderr.replace("│", " ").split())
    assert not (tmp_path / "set").exists()
