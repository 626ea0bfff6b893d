"""From a ROS client to the simulated driver on ROS and back: the path that the tutorials describe, without hardware."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from harness import ServiceProcess, eventually, router
from motions import HOME, KEYS, ROBOT, moved
from rclpy.action import ActionClient
from ros_client import RosClient
from sensor_msgs.msg import JointState

from curobo_msgs.action import SendTrajectory
from curobo_msgs.srv import SetPlanner, SetRobotStrategy, TrajectoryGeneration
from zarm_contract.bus import Bus
from zarm_contract.messages import JointState as BusJointState

NODE = "/unified_planner"
FAR = moved(0.9, -0.4, 0.2)


@dataclass
class Lab:
    """A client on ROS, and what the driver tells of the arm."""

    ros: RosClient
    told: list[JointState]
    action: ActionClient
    feedback: list[SendTrajectory.Feedback]

    def switch(self, strategy: str) -> None:
        answer = self.ros.call(
            SetRobotStrategy, f"{NODE}/set_robot_strategy", SetRobotStrategy.Request(robot_strategy=strategy)
        )
        assert answer.success, answer.message
        assert answer.current_robot_strategy == strategy

    def plan(self, goal: np.ndarray) -> None:
        answer = self.ros.call(
            TrajectoryGeneration,
            f"{NODE}/generate_trajectory",
            TrajectoryGeneration.Request(target_joint_positions=goal.tolist()),
        )
        assert answer.success, answer.message

    def send(self):
        """Execute the last plan; the goal's handle."""
        self.feedback.clear()
        goal = SendTrajectory.Goal()
        handle = self.ros.wait(
            self.action.send_goal_async(goal, feedback_callback=lambda message: self.feedback.append(message.feedback))
        )
        assert handle.accepted
        return handle

    def execute(self) -> None:
        outcome = self.ros.wait(self.send().get_result_async())
        assert outcome.result.success, outcome.result.message
        assert outcome.status == GoalStatus.STATUS_SUCCEEDED

    def arm(self) -> np.ndarray:
        """Where the arm stands: where the driver tells the same again and again."""

        def standing() -> JointState | None:
            last = self.told[-30:]
            return last[-1] if len(last) == 30 and len({tuple(state.position) for state in last}) == 1 else None

        state = eventually(standing, "the arm stands")
        return np.array([state.position[list(state.name).index(name)] for name in ROBOT.descriptor.joints])


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Lab]:
    folder: Path = tmp_path_factory.mktemp("lab")
    with ExitStack() as stack:
        endpoint = stack.enter_context(router())
        bus = stack.enter_context(Bus(endpoint))
        driver = ServiceProcess("leeloo_sim", endpoint, folder, arguments=("--ros",))
        services = [driver, *(ServiceProcess(name, endpoint, folder) for name in ("ros_bridge", "planner", "executor"))]
        for service in services:
            stack.enter_context(service)
        for service in services:
            service.wait_ready(bus, KEYS)
        carried = bus.latest(KEYS.driver_joint_states, BusJointState)
        eventually(carried.get, "the joints of the driver have reached the bus")
        ros = stack.enter_context(RosClient())
        action = ActionClient(ros.node, SendTrajectory, f"{NODE}/execute_trajectory")
        assert action.wait_for_server(60)
        told = ros.heard(JointState, "/dsr01/joint_states", 100)
        answer = ros.call(
            SetPlanner, f"{NODE}/set_planner", SetPlanner.Request(planner_type=SetPlanner.Request.JOINT_SPACE)
        )
        assert answer.success, answer.message
        yield Lab(ros, told, action, [])
        action.destroy()


def test_tutorial_4_with_the_driver_plan_stream_cancel_switch_and_back_to_the_emulator(lab: Lab) -> None:
    lab.switch("joint_speed")
    lab.plan(FAR)
    lab.execute()
    np.testing.assert_allclose(lab.arm(), FAR, atol=0.005)
    progress = [message.step_progression for message in lab.feedback]
    assert progress == sorted(progress)
    assert len(set(progress)) > 3
    assert all(list(message.joint_command.name) == list(ROBOT.descriptor.joints) for message in lab.feedback)

    lab.plan(HOME)
    handle = lab.send()
    eventually(lambda: lab.feedback and lab.feedback[-1].step_progression > 0.3, "the arm is on its way")
    lab.ros.wait(handle.cancel_goal_async())
    outcome = lab.ros.wait(handle.get_result_async())
    assert outcome.status == GoalStatus.STATUS_CANCELED
    stood = lab.arm()
    assert 0.05 < np.max(np.abs(stood - HOME)) < np.max(np.abs(FAR - HOME)) - 0.05

    lab.switch("joint_pose")
    lab.switch("emulator")
    np.testing.assert_allclose(lab.arm(), stood, atol=1e-6)


def test_the_first_version_of_the_path_sends_the_whole_trajectory_and_reads_the_drivers_progress(lab: Lab) -> None:
    lab.switch("joint_trajectory")
    start = lab.arm()
    goal = start + (0.0, 0.0, 0.0, 0.0, 0.0, 0.8)
    lab.plan(goal)
    lab.execute()
    np.testing.assert_allclose(lab.arm(), goal, atol=0.005)
    assert len({message.step_progression for message in lab.feedback}) > 3
