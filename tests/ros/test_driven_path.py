"""From a ROS client to the simulated driver on ROS and back: the path that the tutorials describe, without hardware."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest
from sensor_msgs.msg import JointState

from curobo_msgs.srv import SetPlanner, SetRobotStrategy, TrajectoryGeneration
from support.harness import eventually
from support.ros.client import RosClient
from support.ros.goals import CANCELED, SUCCEEDED, Actions, Sent
from support.ros.stack import KEYS, stack
from support.trajectories import HOME, ROBOT, moved

FAR = moved(0.9, -0.4, 0.2)


@dataclass
class Lab:
    """A client on ROS, and what the driver tells of the arm."""

    ros: RosClient
    report: list[JointState]
    actions: Actions

    def switch(self, strategy: str) -> None:
        answered = self.ros.call(SetRobotStrategy, "set_robot_strategy", robot_strategy=strategy)
        assert answered.success, answered.message
        assert answered.current_robot_strategy == strategy

    def plan(self, goal: np.ndarray) -> None:
        answered = self.ros.call(TrajectoryGeneration, "generate_trajectory", target_joint_positions=goal.tolist())
        assert answered.success, answered.message

    def execute(self) -> Sent:
        """Execute the last plan to its end."""
        sent = self.actions.send()
        status, result = sent.ended()
        assert result.success, result.message
        assert status == SUCCEEDED
        return sent

    def arm(self) -> np.ndarray:
        """Where the arm stands: where the driver tells the same again and again."""

        def standing() -> JointState | None:
            last = self.report[-30:]
            return last[-1] if len(last) == 30 and len({tuple(state.position) for state in last}) == 1 else None

        state = eventually(standing, "the arm stands")
        return np.array([state.position[list(state.name).index(name)] for name in ROBOT.descriptor.joints])


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Lab]:
    with stack(tmp_path_factory.mktemp("lab"), leeloo_sim=("--ros",)) as running:
        carried = running.bus.latest(KEYS.driver_joint_states)
        eventually(carried.get, "the joints of the driver have reached the bus")
        report = running.ros.heard(JointState, "/dsr01/joint_states", 100)
        answered = running.ros.call(SetPlanner, "set_planner", planner_type=SetPlanner.Request.JOINT_SPACE)
        assert answered.success, answered.message
        yield Lab(running.ros, report, Actions(running.ros.node))


@pytest.mark.slow
def test_tutorial_4_runs_on_the_driver_to_the_end(lab: Lab) -> None:
    lab.switch("joint_speed")
    lab.plan(FAR)
    report = lab.execute().feedback
    np.testing.assert_allclose(lab.arm(), FAR, atol=0.005)
    progress = [message.step_progression for message in report]
    assert progress == sorted(progress)
    assert len(set(progress)) > 3
    assert all(list(message.joint_command.name) == list(ROBOT.descriptor.joints) for message in report)

    lab.plan(HOME)
    sent = lab.actions.send()
    assert sent.accepted
    eventually(lambda: sent.feedback and sent.feedback[-1].step_progression > 0.3, "the arm is on its way")
    sent.cancel()
    assert sent.ended()[0] == CANCELED
    stood = lab.arm()
    assert 0.05 < np.max(np.abs(stood - HOME)) < np.max(np.abs(FAR - HOME)) - 0.05

    lab.switch("joint_pose")
    lab.switch("emulator")
    np.testing.assert_allclose(lab.arm(), stood, atol=1e-6)


def test_version_1_sends_whole_trajectories_and_reads_progress(lab: Lab) -> None:
    lab.switch("joint_trajectory")
    start = lab.arm()
    goal = start + (0.0, 0.0, 0.0, 0.0, 0.0, 0.8)
    lab.plan(goal)
    report = lab.execute().feedback
    np.testing.assert_allclose(lab.arm(), goal, atol=0.005)
    assert len({message.step_progression for message in report}) > 3
