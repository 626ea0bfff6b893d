"""The stand-in for ros2_control's trajectory controller does what the documentation of that says."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import pytest
from builtin_interfaces.msg import Duration
from control_msgs.action import FollowJointTrajectory
from control_msgs.msg import JointTolerance
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from support.harness import PATIENCE, eventually
from support.ros.client import RosClient
from support.ros.node import answer
from support.ros.stack import controller
from zarm_contract.robot import load_robot

ROBOT = load_robot("ur5e")
JOINTS, HOME = ROBOT.descriptor.joints, ROBOT.descriptor.home
TOPIC = ROBOT.descriptor.strategy_params.command_topic
Result = FollowJointTrajectory.Result


class StandIn:
    """A client of the stand-in; positions are those of the first joint from home."""

    def __init__(self, node: Node) -> None:
        self.node = node
        self.states: list[JointState] = RosClient(node).heard(
            JointState, ROBOT.descriptor.strategy_params.joint_states_topic
        )
        self.action = ActionClient(node, FollowJointTrajectory, f"{TOPIC.rpartition('/')[0]}/follow_joint_trajectory")
        assert self.action.wait_for_server(PATIENCE)
        self.faults = node.create_publisher(String, f"{TOPIC}/fault", 10)
        eventually(self.faults.get_subscription_count, "the stand-in takes faults")

    def send(self, trajectory: JointTrajectory, **fields: object) -> Any:
        """The handle of a goal that is accepted."""
        goal = FollowJointTrajectory.Goal(trajectory=trajectory, **fields)
        handle = answer(self.action.send_goal_async(goal), "the goal is answered")
        assert handle.accepted
        return handle

    def motion(self) -> list[tuple[float, float, float]]:
        """Stamp, position and velocity of all states so far."""
        return [
            (seconds(state.header.stamp), state.position[k] - HOME[0], state.velocity[k])
            for state in [*self.states]  # more come meanwhile
            for k in (list(state.name).index(JOINTS[0]),)
        ]

    def result(self, handle: Any) -> int:
        return int(answer(handle.get_result_async(), "the goal ends").result.error_code)


def seconds(stamp: Any) -> float:
    return float(Time.from_msg(stamp).nanoseconds * 1e-9)


def to(*points: tuple[float, float]) -> JointTrajectory:
    """A trajectory of the first joint through positions (rad from home), each at a time (s)."""
    made = JointTrajectory(joint_names=list(JOINTS))
    for time, position in points:
        row: Sequence[float] = [HOME[0] + position, *HOME[1:]]
        when = Duration(sec=int(time), nanosec=int((time % 1.0) * 1e9))
        made.points.append(JointTrajectoryPoint(positions=row, time_from_start=when))
    return made


@pytest.fixture
def arm(node: Node) -> Iterator[StandIn]:
    with controller(ROBOT):
        yield StandIn(node)


def test_a_trajectory_waits_for_its_stamp_while_the_old_one_runs(arm: StandIn) -> None:
    first = arm.send(to((2.0, 1.0)))
    eventually(lambda: arm.states and arm.motion()[-1][1] > 0.1, "the arm moves")
    second = to((0.5, 0.0))
    begin = arm.node.get_clock().now().nanoseconds + 300_000_000
    second.header.stamp = Time(nanoseconds=begin).to_msg()
    handle = arm.send(second)
    assert arm.result(first) == Result.INVALID_GOAL
    assert arm.result(handle) == Result.SUCCESSFUL
    eventually(lambda: abs(arm.motion()[-1][1]) < 1e-6, "the arm is back")
    before = [velocity for stamp, position, velocity in arm.motion() if stamp < begin * 1e-9 and position > 0.1]
    assert before
    assert all(velocity > 0.0 for velocity in before)


def test_a_cancel_brakes(arm: StandIn) -> None:
    handle = arm.send(to((4.0, 4.0)))
    eventually(lambda: arm.states and arm.motion()[-1][2] > 0.5, "the arm moves")
    answer(handle.cancel_goal_async(), "the cancel is answered")
    eventually(lambda: arm.motion()[-1][2] == 0.0, "the arm rests")
    top = max(velocity for *_, velocity in arm.motion())
    assert [velocity for *_, velocity in arm.motion() if 0.1 * top < velocity < 0.9 * top], "it is not at rest at once"


@pytest.mark.parametrize(
    ("field", "allowed", "code"),
    [
        ("path_tolerance", 0.1, Result.PATH_TOLERANCE_VIOLATED),
        ("goal_tolerance", 0.1, Result.GOAL_TOLERANCE_VIOLATED),
        ("path_tolerance", 0.3, Result.SUCCESSFUL),
        ("goal_tolerance", 0.0, Result.SUCCESSFUL),
    ],
)
def test_tolerances_of_a_goal_are_kept(arm: StandIn, field: str, allowed: float, code: int) -> None:
    arm.faults.publish(String(data="off 0.2"))
    eventually(lambda: arm.states and arm.motion()[-1][1] > 0.15, "the joints are measured elsewhere")
    tolerances = [JointTolerance(name=JOINTS[0], position=allowed)]
    assert arm.result(arm.send(to((0.3, 0.1)), **{field: tolerances})) == code


@pytest.mark.parametrize("wrong", ["times", "joints", "end"])
def test_a_goal_that_cannot_be_followed_is_rejected(arm: StandIn, wrong: str) -> None:
    trajectory = to((0.5, 0.1), (0.5 if wrong == "times" else 1.0, 0.2))
    if wrong == "joints":
        trajectory.joint_names[0] = "elbow"
    if wrong == "end":
        trajectory.points[-1].velocities = [0.1] * len(JOINTS)
    goal = FollowJointTrajectory.Goal(trajectory=trajectory)
    assert not answer(arm.action.send_goal_async(goal), "the goal is answered").accepted
