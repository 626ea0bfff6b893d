"""A full disk under the state: what moves goes on, what cannot be put on record is refused, and no old file is lost."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest

from support.executor.client import Client
from support.executor.driven import THERE, Driven
from support.harness import PATIENCE, ServiceProcess, eventually
from support.resources import favour
from support.trajectories import HOME, KEYS, moved, rest_to_rest
from zarm_contract.errors import Unavailable
from zarm_contract.messages import (
    AddObjects,
    Cuboid,
    JointGoal,
    JointState,
    Nothing,
    PlanRequest,
    Scene,
    SceneEdit,
    SceneEdited,
)
from zarm_runtime.bus import Bus
from zarm_runtime.state_file import StateFile

NO_SPACE = "No space left on device"
SLOW = rest_to_rest(moved(0.8), slower=3.0)
TABLE = Cuboid(kind="cuboid", name="table", position=(0.6, 0.0, -0.5), size=(1.0, 1.6, 0.1))


def saved_position(file: Path) -> tuple[float, ...]:
    state = StateFile(file, JointState).load()
    assert state is not None
    return state.position


class Disk:
    """A small file system at `folder` that can be filled to the last byte."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._ballast = folder / "ballast"

    def fill(self) -> None:
        with self._ballast.open("ab", buffering=0) as ballast:
            for size in (4096, 1):
                with suppress(OSError):
                    while True:
                        ballast.write(b"\x00" * size)

    def empty(self) -> None:
        self._ballast.unlink()

    def state(self) -> tuple[str, str]:
        """The option that makes a service keep its state here; its log lies elsewhere."""
        return "--state", str(self.folder)


class DrivenFrom(Driven):
    """A robot behind a driver, the state of whose executor is on a disk."""

    def __init__(self, disk: Disk, bus: Bus, endpoint: str, folder: Path, strategy: str) -> None:
        super().__init__(bus, endpoint, folder, strategy)
        self._disk = disk

    def new_executor(self) -> ServiceProcess:
        arguments = ("--strategy", self.strategy, *self._disk.state())
        return ServiceProcess("executor", self.endpoint, self.folder, arguments=arguments)


@contextmanager
def small_disk(folder: Path) -> Iterator[Disk]:
    folder.mkdir()
    mount = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=128k", "tmpfs", str(folder)], capture_output=True, check=False, text=True
    )
    if mount.returncode != 0:
        pytest.skip(f"no file system may be mounted here: {mount.stderr.strip()}")
    try:
        yield Disk(folder)
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Disk]:
    with small_disk(tmp_path / "disk") as disk:
        yield disk


def test_a_motion_survives_a_full_disk_and_the_next_is_refused(
    bus: Bus, endpoint: str, tmp_path: Path, disk: Disk
) -> None:
    saved = disk.folder / KEYS.robot / "emulated_robot.json"
    with ServiceProcess("executor", endpoint, tmp_path, arguments=disk.state()) as executor:
        executor.wait_ready(bus, KEYS)
        client = Client(bus)
        goal_id = client.execute(SLOW)
        client.under_way(goal_id, 0.1)

        def not_saved() -> bool:
            disk.fill()
            return "is no longer saved" in executor.output()

        eventually(not_saved, "the disk is full")
        assert saved_position(saved) is not None
        assert client.ended(goal_id).status == "succeeded"
        disk.fill()  # the record of the goal is gone, which has made room; the position may have been saved in it
        old = saved.read_bytes()
        at = client.position()
        np.testing.assert_allclose(at, moved(0.8), atol=1e-9)
        goals = {goal.goal_id for goal in client.goals}
        with pytest.raises(Unavailable, match=NO_SPACE):
            client.execute(rest_to_rest(HOME, at))
        assert client.stands()
        np.testing.assert_array_equal(client.position(), at)
        assert client.state().mode == "idle"
        assert {goal.goal_id for goal in client.goals} == goals
        assert client.strategy("ghost").active == "ghost"
        with pytest.raises(Unavailable, match="ghost is active again"):
            client.strategy("emulator")
        assert saved.read_bytes() == old
        assert executor.output().count("is no longer saved") == 1

        disk.empty()
        assert client.strategy("emulator").active == "emulator"
        assert client.ended(client.execute(rest_to_rest(HOME, at))).status == "succeeded"
        eventually(lambda: np.allclose(saved_position(saved), HOME), "the position is saved")
        assert sorted(file.name for file in saved.parent.iterdir()) == ["emulated_robot.json", "executor.lock"]


@pytest.mark.slow
def test_the_emulator_does_not_start_on_a_full_disk_and_says_why(endpoint: str, tmp_path: Path, disk: Disk) -> None:
    disk.fill()
    with ServiceProcess("executor", endpoint, tmp_path, arguments=disk.state()) as executor:
        assert executor.process.wait(PATIENCE) == 1
        assert NO_SPACE in executor.output()
        assert "make room" in executor.output()
        assert "Traceback" not in executor.output()


@pytest.mark.slow
def test_a_full_disk_stops_a_real_robot_and_moves_nothing(bus: Bus, endpoint: str, tmp_path: Path, disk: Disk) -> None:
    with ExitStack() as stack:
        robot = DrivenFrom(disk, bus, endpoint, tmp_path, "joint_speed")
        robot.driver = stack.enter_context(robot.new_driver())
        robot.driver.wait_ready(bus, KEYS)
        robot.executor = stack.enter_context(robot.new_executor())
        robot.executor.wait_ready(bus, KEYS)
        favour(robot.driver, robot.executor)
        goal_id = robot.client.execute(THERE)
        robot.client.under_way(goal_id)
        disk.fill()
        robot.client.command(KEYS.stop)
        assert robot.client.ended(goal_id).status == "cancelled"
        stopped = robot.at_rest()
        disk.fill()
        with pytest.raises(Unavailable, match=NO_SPACE):
            robot.client.execute(rest_to_rest(HOME, stopped))
        with pytest.raises(Unavailable, match="joint_speed is active again"):
            robot.client.strategy("emulator")
        assert robot.client.state().mode == "idle"
        np.testing.assert_array_equal(robot.at_rest(), stopped)
        robot.executor.kill()
        with robot.new_executor() as again:
            again.wait_ready(bus, KEYS)
            favour(again)
            assert robot.client.strategy().active == "joint_speed"
            np.testing.assert_array_equal(robot.at_rest(), stopped)
            disk.empty()
            robot.works_again()


@pytest.mark.slow  # files of state are in unit/runtime/test_state_file.py
def test_a_full_disk_refuses_scene_edits_and_keeps_the_old_scene(
    bus: Bus, endpoint: str, tmp_path: Path, disk: Disk
) -> None:
    file = disk.folder / KEYS.robot / "scene.json"

    def add(name: str) -> SceneEdited:
        edit = AddObjects(op="add", objects=(TABLE.model_copy(update={"name": name}),))
        return bus.call(KEYS.scene_edit, SceneEdit(edit=edit), timeout=PATIENCE)

    with ServiceProcess("planner", endpoint, tmp_path, arguments=disk.state()) as planner:
        planner.wait_ready(bus, KEYS)
        before = add("table")
        old = file.read_bytes()
        disk.fill()
        for _ in range(3):
            with pytest.raises(Unavailable, match=NO_SPACE):
                add("shelf")
        assert bus.read(KEYS.scene_revision, timeout=PATIENCE) == before
        assert [item.name for item in bus.read(KEYS.scene, timeout=PATIENCE).objects] == ["table"]
        assert file.read_bytes() == old
        goal = JointGoal(kind="joints", position=tuple(moved(0.3).tolist()))
        made = bus.call(KEYS.plan, PlanRequest(goal=goal, start=tuple(HOME)), timeout=PATIENCE)
        assert made.scene_revision == before.revision
        disk.empty()
        assert add("shelf").revision != before.revision
        disk.fill()
        planner.kill()
    with ServiceProcess("planner", endpoint, tmp_path, arguments=disk.state()) as planner:
        restored = eventually(lambda: _scene(bus), "the planner is back")
        assert [item.name for item in restored.objects] == ["table", "shelf"]


def _scene(bus: Bus) -> Scene | None:
    try:
        bus.call(KEYS.health("planner"), Nothing(), timeout=PATIENCE)
        return bus.read(KEYS.scene, timeout=PATIENCE)
    except Unavailable:
        return None
