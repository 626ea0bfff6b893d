"""The simulated driver on ROS behaves to its topics as the real one does."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float32
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from support.harness import PATIENCE, ServiceProcess, eventually, router
from support.ros.node import running_node
from zarm_contract import messages
from zarm_contract.errors import Unavailable
from zarm_contract.keys import Keys
from zarm_contract.messages import DriverFault
from zarm_contract.robot import load_robot
from zarm_runtime.bus import Bus

HUMBLE = ["joint_1", "joint_2", "joint_4", "joint_5", "joint_3", "joint_6"]
EVERY_MESSAGE = QoSProfile(depth=10_000, reliability=ReliabilityPolicy.RELIABLE)
SPEED = (0.2, -0.1, 0.0, 0.3, 0.0, -0.2)


def trajectory(
    *, velocities: Sequence[Sequence[float]] = (), positions: Sequence[Sequence[float]] = ()
) -> JointTrajectory:
    """Points as nobody else has to read them: without times, under names that no robot has."""
    points = [JointTrajectoryPoint(velocities=list(row)) for row in velocities]
    points += [JointTrajectoryPoint(positions=list(row)) for row in positions]
    return JointTrajectory(joint_names=["these", "are", "not", "read"], points=points)


@dataclasses.dataclass
class Arm:
    """The process `driver`, what it has reported so far, and `command` that sends it a trajectory."""

    bus: Bus
    keys: Keys
    joints: tuple[str, ...]
    driver: ServiceProcess
    trace: Path
    command: Callable[[JointTrajectory], None]
    states: list[JointState]
    progress: list[float]

    def position(self, state: JointState) -> np.ndarray:
        """In kinematic order, (J,) rad."""
        return np.array([state.position[list(state.name).index(name)] for name in self.joints])

    def at_rest(self) -> np.ndarray:
        """Wait until it tells that it stands, and goes on to; where, (J,) rad."""
        seen = len(self.states)
        eventually(lambda: len(self.states) > seen + 3 and not any(self.states[-1].velocity), "the arm stands")
        seen, where = len(self.states), self.states[-1].position
        eventually(lambda: len(self.states) > seen + 50, "it goes on to tell its joints")
        assert all(state.position == where for state in self.states[seen:])
        return self.position(self.states[-1])

    def moving(self) -> None:
        eventually(lambda: abs(self.states[-1].velocity[0]) > 0.9 * SPEED[0], "the arm moves")

    def set_fault(self, fault: DriverFault) -> None:
        self.bus.call(self.keys.simulated_fault, fault, timeout=10)


@contextmanager
def driven(node: Node, folder: Path, *arguments: str, robot: str = "doosan_m1013") -> Iterator[Arm]:
    """A simulated driver of a robot, on a router of its own, and heard."""
    descriptor = load_robot(robot).descriptor
    keys, params, trace = Keys(robot), descriptor.strategy_params, folder / "trace"
    assert params is not None
    states: list[JointState] = []
    progress: list[float] = []
    node.create_subscription(JointState, params.joint_states_topic, states.append, EVERY_MESSAGE)
    if params.state_topic is not None:
        node.create_subscription(
            Float32, params.state_topic, lambda report: progress.append(report.data), EVERY_MESSAGE
        )
    command = node.create_publisher(JointTrajectory, params.command_topic, 10)
    options = ("--ros", "--trace", str(trace), *arguments)
    with (
        router() as endpoint,
        Bus(endpoint) as bus,
        ServiceProcess("leeloo_sim", endpoint, folder, robot, arguments=options) as driver,
    ):
        driver.wait_ready(bus, keys)
        eventually(lambda: states and command.get_subscription_count(), "the driver is found on ROS")
        yield Arm(bus, keys, descriptor.joints, driver, trace, command.publish, states, progress)


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Arm]:
    with running_node("shared") as node, driven(node, tmp_path_factory.mktemp("leeloo")) as arm:
        yield arm


@pytest.fixture
def arm(shared: Arm) -> Arm:
    """The M1013 that plays velocities, in order and at rest, and nothing told of it yet."""
    shared.set_fault(DriverFault())
    shared.command(trajectory())
    shared.at_rest()
    shared.progress.clear()
    shared.states.clear()
    eventually(lambda: shared.states, "it is heard")
    return shared


def test_it_plays_velocities_by_index_and_reports_progress(arm: Arm) -> None:
    on_the_bus: list[messages.JointState] = []
    arm.bus.subscribe(arm.keys.driver_joint_states, lambda _, state: on_the_bus.append(state))
    began = arm.at_rest()
    assert arm.progress == []
    arm.command(trajectory(velocities=[SPEED] * 50))
    eventually(lambda: 1.0 in arm.progress, "the last point is told")
    ended = arm.at_rest()
    np.testing.assert_allclose(ended - began, 50 * 0.02 * np.array(SPEED), atol=1e-3)
    np.testing.assert_allclose(arm.progress, np.arange(1, 51) / 50, rtol=1e-6)
    assert on_the_bus == []


def test_joints_come_every_10_ms_as_from_humble(arm: Arm) -> None:
    arm.command(trajectory(velocities=[SPEED] * 100))
    eventually(lambda: 1.0 in arm.progress, "the last point is told")
    state = arm.states[-1]
    assert state.name == HUMBLE
    assert np.isnan(state.effort).all()
    assert state.header.stamp.sec > 0
    at_speed = [state.position[0] for state in arm.states if abs(state.velocity[0] - SPEED[0]) < 1e-6]
    assert np.median(np.diff(at_speed)) == pytest.approx(0.01 * SPEED[0])


def test_its_joint_states_are_reliable_and_transient_local(arm: Arm, node: Node) -> None:
    (publisher,) = eventually(lambda: node.get_publishers_info_by_topic("/dsr01/joint_states"), "the driver is found")
    assert publisher.qos_profile.reliability == ReliabilityPolicy.RELIABLE
    assert publisher.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL


def test_an_empty_trajectory_stops_it_without_progress(arm: Arm) -> None:
    arm.command(trajectory(velocities=[SPEED] * 5000))
    arm.moving()
    arm.command(trajectory())
    arm.at_rest()
    report = len(arm.progress)
    assert arm.progress[-1] < 1.0
    arm.at_rest()
    assert len(arm.progress) == report


@pytest.mark.slow  # as in unit/leeloo_sim/test_player.py
def test_a_new_trajectory_replaces_what_is_left_of_the_last(arm: Arm) -> None:
    arm.command(trajectory(velocities=[SPEED] * 5000))
    arm.moving()
    arm.command(trajectory(velocities=[[0.0] * 6] * 10))
    eventually(lambda: arm.progress[-1] == 1.0, "the second is played to its end")
    arm.at_rest()


@pytest.mark.slow  # as in unit/leeloo_sim/test_player.py
def test_a_point_with_too_few_velocities_repeats_the_one_before(arm: Arm) -> None:
    began = arm.at_rest()
    arm.command(trajectory(velocities=[SPEED] * 25 + [[0.0, 0.0, 0.0]] * 25))
    eventually(lambda: 1.0 in arm.progress, "the last point is told")
    np.testing.assert_allclose(arm.at_rest() - began, 50 * 0.02 * np.array(SPEED), atol=1e-3)
    assert "points that lack what is played repeat the one before points=25" in arm.driver.output()


def aside(began: np.ndarray) -> np.ndarray:
    """50 points from where the arm stands to 0.1 rad beside, (50, J) rad."""
    u = np.linspace(0.0, 1.0, 50)[:, None]
    return began + 0.1 * (10 * u**3 - 15 * u**4 + 6 * u**5)


@pytest.mark.slow  # as in unit/leeloo_sim/test_player.py
def test_it_plays_positions_of_a_trajectory_without_velocities(arm: Arm) -> None:
    there = aside(arm.at_rest())
    arm.command(trajectory(positions=there.tolist()))
    eventually(lambda: np.allclose(arm.position(arm.states[-1]), there[-1], atol=1e-3), "the arm arrives")


@pytest.mark.slow
def test_with_such_a_descriptor_it_plays_positions_only(node: Node, tmp_path: Path) -> None:
    with driven(node, tmp_path, "--plays", "position", robot="ur5e") as arm:
        there = aside(arm.at_rest())
        arm.command(trajectory(positions=there.tolist()))
        eventually(lambda: np.allclose(arm.position(arm.states[-1]), there[-1], atol=1e-3), "the arm arrives")
        np.testing.assert_allclose(arm.at_rest(), there[-1], atol=1e-3)


def test_silenced_it_moves_on_and_publishes_nothing(arm: Arm) -> None:
    arm.command(trajectory(velocities=[SPEED] * 5000))
    arm.moving()
    arm.set_fault(DriverFault(silent=True))
    lines = len(arm.trace.read_text().splitlines())
    eventually(lambda: len(arm.trace.read_text().splitlines()) > lines + 100, "the arm has moved on for a second")
    arm.set_fault(DriverFault())
    silenced = np.array([state.position[0] for state in arm.states])
    eventually(lambda: len(arm.states) > len(silenced), "it is heard again")
    assert arm.states[len(silenced)].position[0] - silenced[-1] > 90 * 0.01 * SPEED[0]


@pytest.mark.slow
def test_stalled_it_stands_and_goes_on_afterwards(arm: Arm) -> None:
    began = arm.at_rest()
    arm.command(trajectory(velocities=[SPEED] * 100))
    arm.moving()
    arm.set_fault(DriverFault(stall=True))
    stood = arm.at_rest()
    assert stood[0] - began[0] < 100 * 0.02 * SPEED[0] - 0.01
    arm.set_fault(DriverFault())
    eventually(lambda: arm.progress[-1] == 1.0, "the last point is told")
    assert arm.at_rest()[0] > stood[0] + 0.01


def test_it_dies_when_it_is_told_to(node: Node, tmp_path: Path) -> None:
    with driven(node, tmp_path) as arm:
        with suppress(Unavailable):  # it is not there any more to answer
            arm.set_fault(DriverFault(die=True))
        assert arm.driver.process.wait(PATIENCE) == 1
