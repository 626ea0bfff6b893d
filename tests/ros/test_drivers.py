"""A driver on ROS topics is carried to the executor and back: what it tells, what it is sent, and what it does wrong."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import pytest
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float32, String
from trajectory_msgs.msg import JointTrajectory

from support.executor.client import Client
from support.harness import ServiceProcess, eventually, router
from support.ros.client import RosClient, reported
from support.ros.node import destroyed
from support.ros.stack import controller
from support.trajectories import patient, rest_to_rest
from zarm_contract import messages as m
from zarm_contract.keys import Keys
from zarm_contract.robot import load_robot
from zarm_runtime.bus import Bus

UR5E, M1013 = load_robot("ur5e"), load_robot("doosan_m1013")


@pytest.fixture
def ros(node: Node) -> RosClient:
    return RosClient(node)


@pytest.fixture(scope="module")
def place() -> Iterator[str]:
    """The router of the bridge that most tests share."""
    with router() as address:
        yield address


@pytest.fixture
def endpoint(place: str) -> str:
    return place


@pytest.fixture(scope="module")
def bridge(place: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServiceProcess]:
    with Bus(place) as bus, ServiceProcess("ros_bridge", place, tmp_path_factory.mktemp("bridge")) as process:
        process.wait_ready(bus, Keys("doosan_m1013"))
        yield process


@pytest.fixture
def apart() -> Iterator[tuple[str, Bus]]:
    """A router without that bridge, and a session on it."""
    with router() as address, Bus(address) as session:
        yield address, session


FAULTS = f"{UR5E.descriptor.strategy_params.command_topic}/fault"


@contextmanager
def ur5e(endpoint: str, bus: Bus, folder: Path, *options: str) -> Iterator[Client]:
    """A UR5e under ros2_control that is moved by whole trajectories."""
    keys = Keys("ur5e")
    with ExitStack() as stack:
        stack.enter_context(controller(UR5E, *options))
        bridge = stack.enter_context(ServiceProcess("ros_bridge", endpoint, folder, robot="ur5e"))
        bridge.wait_ready(bus, keys)
        robot = str(patient(folder / "patient", UR5E))
        executor = ServiceProcess(
            "executor", endpoint, folder, robot=robot, arguments=("--strategy", "joint_trajectory")
        )
        stack.enter_context(executor).wait_ready(bus, keys)
        if not options:
            eventually(lambda: "a controller has come" in bridge.output(), "the bridge knows the action")
        yield Client(bus, keys)


def faulty(ros: RosClient, fault: str) -> None:
    """Give the controller this fault."""
    publisher = ros.node.create_publisher(String, FAULTS, 10)
    eventually(publisher.get_subscription_count, "the controller listens")
    publisher.publish(String(data=fault))


def test_a_controller_s_refusal_ends_the_goal_with_its_reason(
    apart: tuple[str, Bus], tmp_path: Path, ros: RosClient
) -> None:
    home = np.array(UR5E.descriptor.home)
    there = home + (0.6, -0.3, 0.2, 0.0, 0.0, 0.4)
    with ur5e(*apart, tmp_path) as client:
        goal = client.execute(rest_to_rest(there, home, robot=UR5E, slower=2.0))
        client.under_way(goal)
        faulty(ros, "violate")
        ended = client.ended(goal)
        assert ended.status == "aborted"
        assert "PATH_TOLERANCE_VIOLATED: the elbow is held" in ended.problem.message
        client.bus.call(client.keys.reset, m.Nothing(), timeout=10)
        faulty(ros, "inactive")
        back = client.execute(rest_to_rest(home, np.array(client.position()), robot=UR5E))
        ended = client.ended(back)
        assert ended.status == "aborted"
        assert "refused the trajectory" in ended.problem.message
        client.bus.call(client.keys.reset, m.Nothing(), timeout=10)
        faulty(ros, "")
        last = client.execute(rest_to_rest(home, np.array(client.position()), robot=UR5E))
        assert client.ended(last).status == "succeeded"


def test_a_controller_without_an_action_is_used_by_topic(apart: tuple[str, Bus], tmp_path: Path) -> None:
    home = np.array(UR5E.descriptor.home)
    there = home + (0.6, -0.3, 0.2, 0.0, 0.0, 0.4)
    with ur5e(*apart, tmp_path, "--topic-alone") as client:
        goal = client.execute(rest_to_rest(there, home, robot=UR5E))
        assert client.ended(goal).status == "succeeded"
        np.testing.assert_allclose(client.position(), there, atol=1e-3)
        back = client.execute(rest_to_rest(home, there, robot=UR5E, slower=3.0))
        client.under_way(back)
        client.cancel(back)
        assert client.ended(back).status == "cancelled"
        eventually(client.stands, "the robot rests")


def test_a_motion_waits_while_the_robot_s_own_controls_pause_it(
    apart: tuple[str, Bus], tmp_path: Path, ros: RosClient
) -> None:
    home = np.array(UR5E.descriptor.home)
    there = home + (0.6, -0.3, 0.2, 0.0, 0.0, 0.4)
    with ur5e(*apart, tmp_path) as client:
        goal = client.execute(rest_to_rest(there, home, robot=UR5E))
        client.under_way(goal)
        faulty(ros, "slow 0")
        eventually(client.stands, "the robot stands")
        waited = time.monotonic() + 2 * UR5E.descriptor.execution.progress_timeout
        eventually(lambda: time.monotonic() > waited, "longer than a driver may stand still otherwise")
        assert not client.goal(goal).done
        faulty(ros, "slow 40")
        assert client.ended(goal).status == "succeeded"
        np.testing.assert_allclose(client.position(), there, atol=1e-3)


@pytest.mark.slow  # as the M1013 is, in test_driven_path.py
def test_a_ur5e_is_moved_through_the_action_of_its_controller(apart: tuple[str, Bus], tmp_path: Path) -> None:
    there = np.array(UR5E.descriptor.home) + (0.6, -0.3, 0.2, 0.0, 0.0, 0.4)
    with ur5e(*apart, tmp_path) as client:
        goal = client.execute(rest_to_rest(there, np.array(UR5E.descriptor.home), robot=UR5E))
        assert client.ended(goal).status == "succeeded"
        np.testing.assert_allclose(client.position(), there, atol=1e-3)
        back = client.execute(rest_to_rest(np.array(UR5E.descriptor.home), there, robot=UR5E, slower=3.0))
        client.under_way(back)
        client.cancel(back)
        assert client.ended(back).status == "cancelled"
        assert client.stands()
        assert np.max(np.abs(client.position() - there)) > 0.05


def told_joints(bus: Bus, ros: RosClient) -> float:
    """Have the driver tell its joints, so that a command can be based on them; their stamp."""
    latest = bus.latest(Keys("doosan_m1013").driver_joint_states)
    publisher = ros.node.create_publisher(JointState, "/dsr01/joint_states", 10)
    eventually(publisher.get_subscription_count, "the bridge listens")
    return eventually(
        lambda: publisher.publish(_state(HUMBLE, VALUES, stamp=1000)) or latest.get(), "the joints have come"
    ).stamp


def test_a_late_command_does_not_reach_the_driver(bus: Bus, bridge: ServiceProcess, ros: RosClient) -> None:
    heard = ros.heard(JointTrajectory, "/leeloo/execute_trajectory")
    names, row = M1013.descriptor.joints, (0.0,) * 6
    commands = bus.publisher(Keys("doosan_m1013").driver_command)
    reported(
        heard, lambda: commands.put(m.DriverCommand(sequence=1, joint_names=names)), "the bridge knows of the driver"
    )
    based_on = told_joints(bus, ros)
    for sequence, stamp, expires_after, points in (
        (2, based_on, 1e-6, 2),
        (3, based_on - 1.0, 1000.0, 2),
        (4, based_on, 1000.0, 3),
    ):
        commands.put(
            m.DriverCommand(
                sequence=sequence,
                joint_names=names,
                based_on=stamp,
                expires_after=expires_after,
                time=tuple(0.02 * k for k in range(points)),
                position=(row,) * points,
            )
        )
    eventually(lambda: [len(one.points) for one in heard if one.points] == [3], "what is in time has come, and no more")
    for sequence in (2, 3):
        assert f"dropped a late command sequence={sequence}" in bridge.output()


def test_commands_reach_the_driver_as_they_are(bus: Bus, bridge: ServiceProcess, ros: RosClient) -> None:
    fresh = {"based_on": told_joints(bus, ros), "expires_after": 1000.0}
    heard = ros.heard(JointTrajectory, "/leeloo/execute_trajectory")
    names = M1013.descriptor.joints
    rows = tuple(tuple(0.1 * i + j for j in range(6)) for i in range(2))
    commands = bus.publisher(Keys("doosan_m1013").driver_command)
    reported(
        heard, lambda: commands.put(m.DriverCommand(sequence=1, joint_names=names)), "the bridge knows of the driver"
    )
    commands.put(
        m.DriverCommand(
            sequence=2, joint_names=names, time=(0.0, 0.02), position=rows, velocity=rows, acceleration=rows, **fresh
        )
    )
    commands.put(m.DriverCommand(sequence=3, joint_names=names, time=(0.0, 1.5), position=rows, **fresh))
    commands.put(m.DriverCommand(sequence=4, joint_names=names))
    moving = [True, True, False]
    eventually(lambda: [bool(one.points) for one in heard[-3:]] == moving, "the commands have come")
    whole, positions, stop = heard[-3:]
    assert list(whole.joint_names) == list(names)
    for point, row in zip(whole.points, rows, strict=True):
        assert list(point.positions) == list(point.velocities) == list(point.accelerations) == list(row)
    assert (whole.points[1].time_from_start.sec, whole.points[1].time_from_start.nanosec) == (0, 20_000_000)
    assert not positions.points[0].velocities
    assert (positions.points[1].time_from_start.sec, positions.points[1].time_from_start.nanosec) == (1, 500_000_000)
    assert not stop.points
    assert whole.header.stamp.sec == whole.header.stamp.nanosec == 0


def _state(names: list[str], position: list[float], velocity: list[float] | None = None, stamp: int = 0) -> JointState:
    message = JointState(name=names, position=position, velocity=velocity or [])
    message.header.stamp.sec = stamp
    return message


HUMBLE = ["joint_1", "joint_2", "joint_4", "joint_5", "joint_3", "joint_6"]
VALUES = [1.0, 2.0, 4.0, 5.0, 3.0, 6.0]


def test_joint_states_arrive_by_name_with_the_driver_s_stamp(bus: Bus, bridge: ServiceProcess, ros: RosClient) -> None:
    latest = bus.latest(Keys("doosan_m1013").driver_joint_states)
    publisher = ros.node.create_publisher(JointState, "/dsr01/joint_states", 10)
    eventually(publisher.get_subscription_count, "the bridge listens")
    in_order = tuple(float(index) for index in range(1, 7))
    for message in (
        _state(HUMBLE, VALUES, [10 * value for value in VALUES], stamp=1_700_000_000),
        _state([name.replace("_", "") for name in HUMBLE], VALUES, stamp=1_700_000_001),
        _state([], VALUES, stamp=1_700_000_002),
        _state(["wheel", *HUMBLE], [0.0, *VALUES], [math.nan] * 7, stamp=1_700_000_003),
    ):
        state = eventually(
            lambda message=message: (
                publisher.publish(message) or ((s := latest.get()) and s.stamp == message.header.stamp.sec and s)
            ),
            "the joints have come",
        )
        assert tuple(state.position[state.joint_names.index(f"joint_{n}")] for n in range(1, 7)) == in_order
        expected = [10 * n for n in in_order] if message.header.stamp.sec == 1_700_000_000 else [0.0] * 6
        assert [state.velocity[state.joint_names.index(f"joint_{n}")] for n in range(1, 7)] == expected


def test_unreadable_joint_states_are_dropped_and_logged_once(bus: Bus, bridge: ServiceProcess, ros: RosClient) -> None:
    heard: list[m.JointState] = []
    bus.subscribe(Keys("doosan_m1013").driver_joint_states, lambda _, state: heard.append(state))
    publisher = ros.node.create_publisher(JointState, "/dsr01/joint_states", 10)
    eventually(publisher.get_subscription_count, "the bridge listens")
    bad = {
        "name: joint_6 missing": _state(HUMBLE[:-1] + ["wrist"], VALUES),
        "name.6: the joint joint_1 appears twice": _state([*HUMBLE, "joint_1"], [*VALUES, 1.0]),
        "position: 5 values for 6 joints": _state(HUMBLE, VALUES[:-1]),
        "velocity: 2 values for 6 joints": _state(HUMBLE, VALUES, [0.0, 0.0]),
        "position: a position is not finite": _state(HUMBLE, [*VALUES[:-1], math.nan]),
        "position: 3 values for 6 joints": _state([], VALUES[:3]),
    }
    eventually(lambda: publisher.publish(_state(HUMBLE, VALUES, stamp=1)) or heard, "the bridge hears")
    for stamp, message in enumerate([*bad.values()] * 3, start=2):
        publisher.publish(message)
        publisher.publish(_state(HUMBLE, VALUES, [0.1] * 6, stamp=stamp))
        eventually(lambda stamp=stamp: heard[-1].stamp == stamp, "what can be read comes through")
    for complaint in bad:
        assert bridge.output().count(complaint) == 1, bridge.output()
    assert all(set(state.joint_names) == set(HUMBLE) for state in heard)


def test_progress_is_of_the_command_that_was_sent_last(bus: Bus, bridge: ServiceProcess, ros: RosClient) -> None:
    keys = Keys("doosan_m1013")
    heard: list[m.DriverProgress] = []
    bus.subscribe(keys.driver_progress, lambda _, progress: heard.append(progress))
    sent = ros.heard(JointTrajectory, "/leeloo/execute_trajectory")
    publisher = ros.node.create_publisher(Float32, "/leeloo/trajectory_state", 10)
    eventually(publisher.get_subscription_count, "the bridge listens")
    commands = bus.publisher(keys.driver_command)
    row = (0.0,) * 6
    command = m.DriverCommand(
        sequence=7,
        joint_names=M1013.descriptor.joints,
        based_on=told_joints(bus, ros),
        expires_after=1000.0,
        time=(0.0, 0.1, 0.2, 0.3),
        position=(row,) * 4,
    )
    reported(sent, lambda: commands.put(command), "the command has come")
    for value in (math.nan, 0.25, 0.5):
        publisher.publish(Float32(data=value))
    eventually(lambda: len(heard) == 2, "the progress has come")
    assert [(progress.sequence, progress.fraction) for progress in heard] == [(7, 0.25), (7, 0.5)]


def test_a_driver_that_comes_late_and_again_is_heard(bus: Bus, bridge: ServiceProcess, ros: RosClient) -> None:
    latest = bus.latest(Keys("doosan_m1013").driver_joint_states)
    for position in (VALUES, [value + 0.1 for value in VALUES]):
        publisher = ros.node.create_publisher(JointState, "/dsr01/joint_states", 10)
        eventually(publisher.get_subscription_count, "the bridge listens")
        report = _state(HUMBLE, position)
        eventually(
            lambda publisher=publisher, report=report, at=position: (
                publisher.publish(report) or ((s := latest.get()) and list(s.position) == at)
            ),
            "the joints have come",
        )
        destroyed(ros.node, ros.node.destroy_publisher, publisher)


def test_the_log_says_when_a_driver_connects_and_disconnects(bridge: ServiceProcess, ros: RosClient) -> None:
    def said(change: str) -> int:
        return bridge.output().count(f"a driver has {change} topic=/leeloo/execute_trajectory")

    for times in (1, 2):
        come, gone = said("come"), said("gone")
        driver = ros.node.create_subscription(JointTrajectory, "/leeloo/execute_trajectory", lambda _: None, 10)
        eventually(lambda come=come: said("come") > come, f"it comes {times}")
        assert said("gone") == gone
        destroyed(ros.node, ros.node.destroy_subscription, driver)
        eventually(lambda gone=gone: said("gone") > gone, f"it goes {times}")


@pytest.mark.slow
def test_a_bridge_shuts_down_cleanly_while_a_driver_publishes(
    apart: tuple[str, Bus], tmp_path: Path, ros: RosClient
) -> None:
    endpoint, bus = apart
    latest = bus.latest(Keys("doosan_m1013").driver_joint_states)
    publisher = ros.node.create_publisher(JointState, "/dsr01/joint_states", 10)
    for stamp in (1, 2, 3):
        state = _state(HUMBLE, VALUES)
        state.header.stamp.sec = stamp
        with ServiceProcess("ros_bridge", endpoint, tmp_path) as bridge:
            bridge.wait_ready(bus, Keys("doosan_m1013"))
            eventually(publisher.get_subscription_count, "the bridge listens")
            telling = ros.node.create_timer(0.0005, lambda state=state: publisher.publish(state))
            eventually(
                lambda stamp=stamp: (report := latest.get()) and report.stamp == stamp, "the bridge carries its joints"
            )
        destroyed(ros.node, ros.node.destroy_timer, telling)
        assert "Traceback" not in bridge.output()
    destroyed(ros.node, ros.node.destroy_publisher, publisher)


def test_two_robots_in_one_bridge_have_their_own_drivers(
    apart: tuple[str, Bus], tmp_path: Path, ros: RosClient
) -> None:
    endpoint, bus = apart
    with (
        ServiceProcess("ros_bridge", endpoint, tmp_path, arguments=("--robot", "doosan_m1013", "ur5e")) as bridge,
        controller(UR5E),
    ):
        for name in ("doosan_m1013", "ur5e"):
            bridge.wait_ready(bus, Keys(name))
        for namespace in ("/doosan_m1013", "/ur5e"):
            eventually(
                lambda at=namespace: ("unified_planner", at) in ros.node.get_node_names_and_namespaces(),
                f"the node of {namespace} is seen",
            )
        states = bus.latest(Keys("ur5e").driver_joint_states)
        state = eventually(states.get, "the joints of the ur5e have come")
        assert sorted(state.joint_names) == sorted(UR5E.descriptor.joints)
        assert bus.latest(Keys("doosan_m1013").driver_joint_states).wait(0.3) is None
