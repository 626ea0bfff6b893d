"""A driver on ROS that vanishes or talks nonsense while the robot moves: the goal ends with the reason, and the lab can go on."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from curobo_msgs.srv import SetRobotStrategy
from support.executor.client import Client
from support.harness import ServiceProcess, eventually
from support.resources import favour
from support.ros.goals import ABORTED, HOME, SUCCEEDED, Actions, Robot, Sent
from support.ros.stack import KEYS, Stack, stack
from support.tiers import sampled
from zarm_contract.messages import DriverFault
from zarm_contract.robot import load_robot

M1013 = load_robot("doosan_m1013").descriptor
JOINTS = list(M1013.joints)
NONSENSE = {
    "name: joint_6 missing among": JointState(name=[*JOINTS[:-1], "wrist"], position=list(HOME)),
    "name.1: the joint  appears twice": JointState(name=[""] * 6, position=list(HOME)),
    "position: a position is not finite": JointState(name=JOINTS, position=[*HOME[:-1], math.nan]),
    "position: 0 values for 6 joints": JointState(name=JOINTS),
    "position: 7 values for 6 joints": JointState(name=JOINTS, position=[*HOME, 0.0]),
    "velocity: 1 values for 6 joints": JointState(name=JOINTS, position=list(HOME), velocity=[0.0]),
}


def on_ros(message: str) -> str:
    """What the executor says as a client on ROS is told it."""
    return message.replace("executor/reset", "/unified_planner/reset_fault")


class Lab:
    """A robot with a driver on ROS, and who moves it: `ros` and `actions` on ROS, `client` on the bus."""

    def __init__(self, running: Stack, folder: Path) -> None:
        self._folder = folder
        self._endpoint = running.processes["executor"].endpoint
        self.bus, self.ros, self.bridge = running.bus, running.ros, running.processes["ros_bridge"]
        self.client, self.robot, self.actions = Client(self.bus, KEYS), Robot(self.bus, KEYS), Actions(self.ros.node)
        self.drivers = ExitStack()

    def new_driver(self, at: tuple[float, ...]) -> ServiceProcess:
        """A driver with its arm at `at`: the real arm is where it was when its driver comes again."""
        options = ("--ros", "--at", *map(str, at))
        driver = ServiceProcess("leeloo_sim", self._endpoint, self._folder, name=KEYS.robot, arguments=options)
        known = self._came()
        self.drivers.enter_context(driver).wait_ready(self.bus, KEYS)
        favour(driver)
        eventually(lambda: self._came() > known, "its commands would reach it")
        return driver

    def _came(self) -> int:
        return self.bridge.output().count("a driver has come")

    def switch(self, strategy: str) -> None:
        """Switch as soon as the driver is heard."""

        def switched() -> bool:
            return self.ros.call(SetRobotStrategy, "set_robot_strategy", robot_strategy=strategy).success

        eventually(switched, f"{strategy} is active")
        self.measured()

    def measured(self) -> None:
        """Wait until everybody has heard of the robot's joints."""
        seen = len(self.client.measured)
        eventually(lambda: len(self.client.measured) > seen + 20, "the robot is measured")

    def under_way(self) -> Sent:
        self.robot.plan(speed=0.15)
        goal = self.actions.send()
        goal.under_way()
        return goal

    def stopped(self, goal: Sent) -> None:
        """Wait until the goal has ended with the executor's word, which is in fault."""
        status, result = goal.ended()
        problem = self.client.mode("fault").problem
        assert problem is not None
        assert (status, result.success, problem.code) == (ABORTED, False, "driver_stalled")
        assert problem.message.endswith(", then reset (executor/reset)")
        assert result.message == on_ros(problem.message)

    def goes_on(self) -> None:
        """Until somebody resets the fault nothing moves the robot; then the next goal does."""
        problem = self.client.state().problem
        assert problem is not None
        why = on_ros(problem.message)
        self.robot.plan()
        status, result = self.actions.send().ended()
        assert (status, result.message) == (ABORTED, f"the executor is in fault: {why}")
        report = self.ros.call(Trigger, "get_robot_strategy")
        switched = self.ros.call(SetRobotStrategy, "set_robot_strategy", robot_strategy=self.client.state().strategy)
        for answered in (report, switched):
            assert answered.success
            assert answered.message.endswith(f"; the robot is in fault: {why}")
        reset = self.ros.call(Trigger, "reset_fault")
        assert (reset.success, reset.message) == (True, f"reset; what was wrong: {why}")
        plan = self.robot.plan()
        status, result = self.actions.send().ended()
        assert status == SUCCEEDED, result.message
        np.testing.assert_allclose(self.robot.joints(), plan.trajectory.position[-1], atol=0.005)


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    with stack(tmp_path_factory.mktemp("drivers")) as started:
        favour(started.processes["executor"], started.processes["ros_bridge"])
        yield started
        assert "Traceback" not in started.processes["ros_bridge"].output()


@pytest.fixture
def lab(running: Stack, tmp_path: Path) -> Iterator[Lab]:
    one = Lab(running, tmp_path)
    with one.drivers:
        yield one
        one.ros.call(Trigger, "reset_fault")  # which a test that failed has left
        one.switch("emulator")


@pytest.mark.slow  # the executor's part is in fault/test_driver_faults.py
@pytest.mark.parametrize("strategy", sampled("joint_speed", "joint_trajectory"))
def test_a_killed_driver_aborts_and_a_new_one_moves_after_reset(lab: Lab, strategy: str) -> None:
    driver = lab.new_driver(HOME)
    lab.switch(strategy)
    goal = lab.under_way()
    driver.kill()
    lab.stopped(goal)
    lab.new_driver(lab.client.measured[-1].position)
    lab.measured()
    lab.goes_on()


@pytest.mark.slow
def test_a_driver_with_unreadable_joint_states_is_stopped(lab: Lab) -> None:
    lab.new_driver(HOME)
    lab.switch("joint_speed")
    report = lab.ros.node.create_publisher(JointState, M1013.strategy_params.joint_states_topic, 10)
    eventually(report.get_subscription_count, "the bridge listens")
    goal = lab.under_way()
    lab.bus.call(KEYS.simulated_fault, DriverFault(silent=True), timeout=10)

    def in_fault() -> bool:
        for message in NONSENSE.values():
            report.publish(message)
        return lab.client.state().mode == "fault"

    eventually(in_fault, "the executor has noticed")
    lab.stopped(goal)
    for fault in NONSENSE:
        assert lab.bridge.output().count(fault) == 1, lab.bridge.output()
    lab.bus.call(KEYS.simulated_fault, DriverFault(), timeout=10)
    lab.measured()
    lab.goes_on()
