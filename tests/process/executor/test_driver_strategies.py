"""A robot moved through its driver, as processes on a router: the simulated one, and the documented example of one."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from support.executor.client import Client
from support.executor.driven import BACK, FAR, LIMIT, THERE, driven
from support.harness import PATIENCE, ServiceProcess, eventually
from support.paths import EXAMPLES
from support.resources import ahead_of_others, favour
from support.tiers import sampled
from support.trajectories import HOME, KEYS, ROBOT, forgiving, moved, patient, rest_to_rest
from support.undriven_panda import undriven_panda
from zarm_contract.errors import Unavailable
from zarm_contract.messages import DriverFault, JointState
from zarm_contract.robot import find_robot, load_robot
from zarm_leeloo_sim.fingers import Fingers
from zarm_runtime.bus import Bus
from zarm_runtime.session import open_client
from zarm_simulated_driver.axes import Axes
from zarm_simulated_driver.bus_side import BusSide
from zarm_simulated_driver.driver import SimulatedDriver
from zarm_simulated_driver.player import Player

EXAMPLE = EXAMPLES / "zenoh_driver.py"


@pytest.mark.parametrize("strategy", sampled("joint_speed", "joint_trajectory"))
def test_a_goal_is_reached_on_every_joint_and_published(bus: Bus, endpoint: str, tmp_path: Path, strategy: str) -> None:
    with driven(bus, endpoint, tmp_path, strategy) as robot:
        goal_id = robot.client.execute(THERE)
        assert robot.client.ended(goal_id).status == "succeeded"
        np.testing.assert_allclose(robot.at_rest(), FAR, atol=0.005)
        np.testing.assert_allclose(robot.client.position(), robot.arm(), atol=1e-9)
        assert robot.client.measured[-1].joint_names == ROBOT.descriptor.joints
        assert robot.reported[-1].joint_names != ROBOT.descriptor.joints
        assert robot.client.measured[-1].stamp in {state.stamp for state in robot.reported}
        progress = [goal.progress for goal in robot.client.goals]
        assert progress == sorted(progress)
        assert len(set(progress)) > 5
        assert any(goal.tick_lateness is not None for goal in robot.client.goals)
        assert robot.commanded_acceleration() <= LIMIT * 1.01


@pytest.mark.slow  # as joint_speed does; what it sends is in unit/executor
def test_joint_pose_reaches_the_goal_on_the_simulated_driver(bus: Bus, endpoint: str, tmp_path: Path) -> None:
    with driven(bus, endpoint, tmp_path, "joint_pose") as robot:
        assert robot.client.ended(robot.client.execute(THERE)).status == "succeeded"
        np.testing.assert_allclose(robot.at_rest(), FAR, atol=0.005)
        chunks = [command for command in robot.commands if command.time]
        assert len(chunks) > 5
        assert not any(command.velocity for command in chunks)


def test_joint_pose_is_refused_by_a_driver_that_plays_velocities(bus: Bus, endpoint: str, tmp_path: Path) -> None:
    with driven(bus, endpoint, tmp_path, "joint_pose", "--plays", "velocity") as robot:
        robot.client.execute(THERE)
        assert "path_tolerance" in robot.fault("tolerance_violated").problem.message
        np.testing.assert_allclose(robot.at_rest(), HOME, atol=1e-9)


@pytest.mark.slow  # as in unit/executor/test_monitor.py
def test_clear_at_rest_lets_the_next_goal_leave_a_fault(bus: Bus, endpoint: str, tmp_path: Path) -> None:
    robot = forgiving(tmp_path / "robot")
    with driven(bus, endpoint, tmp_path, "joint_speed", robot=robot, waited_for=False) as arm:
        arm.client.under_way(arm.client.execute(THERE))
        arm.set_fault(DriverFault(silent=True))
        arm.fault("driver_stalled")
        arm.set_fault(DriverFault())
        goal = rest_to_rest(HOME, arm.at_rest(), slower=1.5)
        assert arm.client.ended(arm.client.execute(goal)).status == "succeeded"
        assert arm.client.state().problem is None
        np.testing.assert_allclose(arm.at_rest(), HOME, atol=0.005)


def test_the_ur5e_reaches_a_goal_without_driver_progress(bus: Bus, endpoint: str, tmp_path: Path) -> None:
    ur5e = load_robot("ur5e")
    home = np.array(ur5e.descriptor.home)
    goal = moved(1.0, 0.5, -0.3, start=home)
    driver = ("--plays", "position", "--ceiling", "400", "--no-progress")
    with driven(bus, endpoint, tmp_path, "joint_trajectory", *driver, robot=ur5e) as robot:
        infos = {info.name: info for info in robot.client.strategy().strategies}
        assert "strategy_params.strategies" in (infos["joint_speed"].reason or "")
        goal_id = robot.client.execute(rest_to_rest(goal, home, robot=ur5e))
        assert robot.client.ended(goal_id).status == "succeeded"
        np.testing.assert_allclose(robot.at_rest(), goal, atol=0.005)
        progress = [state.progress for state in robot.client.goals]
        assert progress == sorted(progress)
        assert len(set(progress)) > 5


@pytest.mark.slow
@pytest.mark.parametrize("strategy", ["joint_speed", "joint_trajectory"])
def test_pause_resume_and_cancel_of_a_robot_behind_a_driver(
    bus: Bus, endpoint: str, tmp_path: Path, strategy: str
) -> None:
    with driven(bus, endpoint, tmp_path, strategy) as robot:
        goal_id = robot.client.execute(THERE)
        robot.client.under_way(goal_id)
        robot.client.command(KEYS.pause)
        robot.client.mode("paused")
        held = robot.at_rest()
        assert np.max(np.abs(held - FAR)) > 0.05
        robot.client.command(KEYS.resume)
        robot.client.under_way(goal_id, 0.6)
        robot.client.command(KEYS.cancel)
        assert robot.client.ended(goal_id).status == "cancelled"
        assert np.max(np.abs(robot.at_rest() - held)) > 0.05
        assert robot.commanded_acceleration() <= LIMIT * 1.01


@pytest.mark.slow
@pytest.mark.parametrize("strategy", ["joint_speed", "joint_pose", "joint_trajectory"])
def test_the_speed_of_a_robot_behind_a_driver_changes_in_motion(
    bus: Bus, endpoint: str, tmp_path: Path, strategy: str
) -> None:
    plays = ("--plays", "position") if strategy == "joint_pose" else ()
    with driven(bus, endpoint, tmp_path, strategy, *plays) as robot:
        goal_id = robot.client.execute(THERE)
        for progress, scale in ((0.2, 0.2), (0.3, 1.0), (0.5, 0.5)):
            robot.client.under_way(goal_id, progress)
            assert robot.client.speed(scale) == scale
        end = robot.client.ended(goal_id)
        assert end.status == "succeeded", end
        assert end.elapsed > 1.3 * end.duration
        np.testing.assert_allclose(robot.at_rest(), FAR, atol=0.01)


@pytest.mark.slow
def test_switching_to_the_driver_and_back_while_it_moves(bus: Bus, endpoint: str, tmp_path: Path) -> None:
    with driven(bus, endpoint, tmp_path, "joint_speed") as robot:
        goal_id = robot.client.execute(THERE)
        robot.client.under_way(goal_id)
        assert robot.client.strategy("joint_trajectory").active == "joint_trajectory"
        assert robot.client.goal(goal_id).status == "cancelled"
        back = robot.client.execute(rest_to_rest(HOME, robot.at_rest(), slower=1.5))
        robot.client.under_way(back)
        assert robot.client.strategy("joint_speed").active == "joint_speed"
        assert robot.client.goal(back).status == "cancelled"
        last = robot.client.execute(rest_to_rest(HOME, robot.at_rest()))
        assert robot.client.ended(last).status == "succeeded"
        np.testing.assert_allclose(robot.at_rest(), HOME, atol=0.005)


def test_a_switch_without_a_driver_is_refused(bus: Bus, endpoint: str, tmp_path: Path) -> None:
    text = find_robot("doosan_m1013").read_text()
    assert "joint_speed, joint_pose, joint_trajectory]" in text
    text = text.replace("joint_speed, joint_pose, joint_trajectory]", "joint_speed, joint_trajectory]")
    descriptor = tmp_path / "robot.yaml"
    descriptor.write_text(text.replace("urdf: doosan_m1013.urdf", f"urdf: {ROBOT.urdf_path}"))
    with ServiceProcess("executor", endpoint, tmp_path, robot=str(descriptor)) as process:
        process.wait_ready(bus, KEYS)
        client = Client(bus)
        infos = {info.name: info for info in client.strategy().strategies}
        assert infos["emulator"].available
        assert not infos["joint_speed"].available
        assert "start the robot's driver" in (infos["joint_speed"].reason or "")
        with pytest.raises(Unavailable, match="emulator is active again"):
            client.strategy("joint_speed")
        assert client.strategy().active == "emulator"
        assert client.ended(client.execute(rest_to_rest(moved(0.05)))).status == "succeeded"


def test_a_strategy_that_the_driver_cannot_play_says_so(bus: Bus, endpoint: str, tmp_path: Path) -> None:
    with ServiceProcess("executor", endpoint, tmp_path, robot="ur5e") as process:
        keys = type(KEYS)("ur5e")
        process.wait_ready(bus, keys)
        client = Client(bus, keys)
        infos = {info.name: info for info in client.strategy().strategies}
        assert "strategy_params.strategies" in (infos["joint_pose"].reason or "")
        with pytest.raises(Unavailable, match="its driver cannot play it"):
            client.strategy("joint_pose")


def test_a_robot_without_strategy_params_says_that(bus: Bus, endpoint: str, tmp_path: Path) -> None:
    with ServiceProcess("executor", endpoint, tmp_path, robot=str(undriven_panda(tmp_path))) as process:
        keys = type(KEYS)("panda")
        process.wait_ready(bus, keys)
        infos = {info.name: info for info in Client(bus, keys).strategy().strategies}
        assert "has no strategy_params" in (infos["joint_trajectory"].reason or "")


def test_an_executor_that_is_to_start_with_a_driver_waits_for_it(bus: Bus, endpoint: str, tmp_path: Path) -> None:
    arguments = ("--strategy", "joint_speed")
    with ServiceProcess("executor", endpoint, tmp_path, arguments=arguments) as process:
        eventually(lambda: "waiting_for_the_robot" in process.output(), "it waits")
        with ServiceProcess("leeloo_sim", endpoint, tmp_path) as driver:
            driver.wait_ready(bus, KEYS)
            process.wait_ready(bus, KEYS)
            assert Client(bus).state().strategy == "joint_speed"


def test_an_executor_that_waits_for_its_driver_can_be_stopped(endpoint: str, tmp_path: Path) -> None:
    with ServiceProcess("executor", endpoint, tmp_path, arguments=("--strategy", "joint_speed")) as process:
        eventually(lambda: "waiting_for_the_robot" in process.output(), "it waits")
        process.process.terminate()
        assert process.process.wait(PATIENCE) == 0
        assert process.output().splitlines()[-1].endswith("stopping")


@pytest.mark.slow
def test_noise_on_the_keys_of_the_driver_does_no_harm(bus: Bus, endpoint: str, tmp_path: Path) -> None:
    noise = [
        b"{",
        b"\xff\xfe\x00",
        b"[" * 100_000,
        b'{"stamp": 0, "joint_names": ["joint_1"], "position": [NaN], "velocity": [0]}',
        b'{"stamp": 0, "joint_names": ["joint_1"], "position": [1], "velocity": [0]}',
        b'{"sequence": 1, "fraction": 2}',
        b'{"sequence": 999999, "fraction": 1}',
    ]
    with driven(bus, endpoint, tmp_path, "joint_speed") as robot, open_client(endpoint) as session:
        goal_id = robot.client.execute(THERE)
        for payload in noise * 5:
            for key in (KEYS.driver_joint_states, KEYS.driver_progress):
                session.put(key, payload)
        assert robot.client.ended(goal_id).status == "succeeded"
        np.testing.assert_allclose(robot.at_rest(), FAR, atol=0.005)


@contextmanager
def example(bus: Bus, endpoint: str) -> Iterator[list[JointState]]:
    """The example of a driver, telling its joints."""
    reported: list[JointState] = []
    bus.subscribe(KEYS.driver_joint_states, lambda _, state: reported.append(state))
    joints, at = reversed(ROBOT.descriptor.joints), [str(value) for value in reversed(HOME.tolist())]
    command = [sys.executable, str(EXAMPLE), "--connect", endpoint, "--joints", *joints, "--at", *at]
    with ahead_of_others():
        process = subprocess.Popen(command)
    try:
        eventually(lambda: reported or process.poll() is not None, "the example tells its joints")
        assert process.poll() is None
        yield reported
    finally:
        process.kill()
        process.wait(PATIENCE)


@pytest.mark.slow
@pytest.mark.parametrize("strategy", sampled("joint_speed", "joint_trajectory"))
def test_the_example_of_a_driver_moves_its_arm(bus: Bus, endpoint: str, tmp_path: Path, strategy: str) -> None:
    with (
        example(bus, endpoint) as reported,
        ServiceProcess(
            "executor", endpoint, tmp_path, robot=str(patient(tmp_path / "patient")), arguments=("--strategy", strategy)
        ) as process,
    ):
        process.wait_ready(bus, KEYS)
        favour(process)
        client = Client(bus)
        goal_id = client.execute(THERE)
        assert client.ended(goal_id).status == "succeeded", client.goal(goal_id)
        np.testing.assert_allclose(client.position(), FAR, atol=0.01)
        np.testing.assert_allclose(client.position(), tuple(reversed(reported[-1].position)), atol=0.01)


@contextmanager
def driver_that_never_tells_of_the_end(bus: Bus) -> Iterator[None]:
    """A driver whose last progress gets lost, as on a link that drops it."""
    side, ended = BusSide(bus, KEYS, Axes.of(ROBOT.descriptor)), threading.Event()
    driver = SimulatedDriver(
        Player(HOME),
        side.publish_joints,
        lambda reported: None if reported.fraction > 0.99 else side.publish_progress(reported),
        Fingers({}),
        lambda _: None,
    )
    side.listen(driver.play)
    thread = threading.Thread(target=driver.run, args=(ended,))
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join(PATIENCE)


@pytest.mark.slow  # as a driver that tells no progress at all
def test_a_goal_is_reached_without_the_driver_s_final_progress(bus: Bus, endpoint: str, tmp_path: Path) -> None:
    descriptor = str(patient(tmp_path / "patient"))
    executor = ServiceProcess(
        "executor", endpoint, tmp_path, robot=descriptor, arguments=("--strategy", "joint_trajectory")
    )
    with driver_that_never_tells_of_the_end(bus), executor:
        executor.wait_ready(bus, KEYS)
        favour(executor)
        client = Client(bus)
        for trajectory in (THERE, BACK):
            goal = client.ended(client.execute(trajectory))
            assert goal.status == "succeeded", goal.problem


def test_the_example_of_a_driver_is_short() -> None:
    assert len(EXAMPLE.read_text().splitlines()) < 100
