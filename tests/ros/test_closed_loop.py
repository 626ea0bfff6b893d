"""Closed loops on ROS, against real processes: the planners mpc and retarget, mpc_move, and the topics of MoveIt Servo."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import chain, repeat
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import Point, Pose, PoseStamped, TwistStamped, Vector3
from nav_msgs.msg import Path
from rcl_interfaces.msg import Log
from sensor_msgs.msg import JointState
from std_msgs.msg import Int8, String
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from visualization_msgs.msg import Marker

from curobo_msgs.action import MpcMove
from curobo_msgs.srv import SetPlanner, SetRobotStrategy, TrajectoryGeneration
from support.harness import PATIENCE, eventually
from support.ros.goals import ABORTED, CANCELED, SUCCEEDED, Actions, Robot, Sent
from support.ros.node import destroyed
from support.ros.stack import KEYS, Stack, stack
from support.tiers import sampled
from support.trajectories import ROBOT, patient
from zarm_contract.messages import CancelRequest, FkRequest
from zarm_ros_bridge.convert.poses import ros_pose
from zarm_ros_bridge.convert.servo_commands import INVALID, NO_WARNING
from zarm_ros_bridge.convert.times import ros_duration, ros_time
from zarm_ros_bridge.servo_commands import RELEASE_SECONDS

MPC, RETARGET, CLASSIC = 1, 6, 0
NODE = "/unified_planner"
PAUSE = "pause the commands"


class Arm:
    """A client on ROS, and what one on the bus sees of the robot."""

    def __init__(self, running: Stack) -> None:
        self.running, self.ros, self.node = running, running.ros, running.ros.node
        self.robot = Robot(running.bus, KEYS)
        self.execute = Actions(self.node)
        self.move = Actions(self.node, "mpc_move", MpcMove)
        self.mpc_goal = self.node.create_publisher(Pose, f"{NODE}/mpc_goal", 10)
        self._publishers: dict[str, Any] = {"mpc_goal": self.mpc_goal}
        self.texts = self.ros.heard(String, f"{NODE}/servo_status/text")

    def choose(self, planner: int) -> None:
        answered = self.ros.call(SetPlanner, "set_planner", planner_type=planner)
        assert answered.success, answered.message

    def strategy(self, name: str) -> None:
        answered = self.ros.call(SetRobotStrategy, "set_robot_strategy", robot_strategy=name)
        assert answered.success, answered.message

    def tip(self) -> Pose:
        """Where it is now."""
        request = FkRequest(joints=(self.robot.joints(),))
        return ros_pose(self.robot.bus.call(KEYS.fk, request, timeout=PATIENCE).poses[0])

    def beside(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Pose:
        """A pose so far (m) from where it is now."""
        tip = self.tip()
        p = tip.position
        return Pose(position=Point(x=p.x + x, y=p.y + y, z=p.z + z), orientation=tip.orientation)

    def away_from(self, pose: Pose) -> float:
        """Distance (m) of the tip from a pose."""
        return float(np.linalg.norm(np.subtract(*(_xyz(one.position) for one in (self.tip(), pose)))))

    def lead_to(self, pose: Pose) -> None:
        """Publish it on mpc_goal until the tip is there: to 1 cm."""
        eventually(lambda: self.mpc_goal.publish(pose) or self.away_from(pose) < 0.01, "the tip follows mpc_goal")

    @contextmanager
    def commanding(self, topic: str, *messages: Any, heeding: bool = True) -> Iterator[Callable[[], None]]:
        """A client that publishes them in turn, 50 a second, and the last one again and again until the test has it pause; `heeding`, it
        pauses where it is told to, as when a busy machine has ended its session, and goes on.
        """
        kind, coming = type(messages[0]), chain(messages, repeat(messages[-1]))
        if topic not in self._publishers:  # they stay, as nothing of a node may go while its thread waits for it
            self._publishers[topic] = self.node.create_publisher(kind, f"{NODE}/{topic}", 10)
        report, paused, ended = len(self.texts), 0.0, threading.Event()

        def command() -> None:
            nonlocal report, paused
            new, report = self.texts[report:], len(self.texts)
            if heeding and any(PAUSE in text.data for text in new):
                paused = time.monotonic() + 2 * RELEASE_SECONDS
            if time.monotonic() > paused and not ended.is_set():
                self._publishers[topic].publish(next(coming))

        timer = self.node.create_timer(0.02, command)
        try:
            yield ended.set
        finally:
            destroyed(self.node, self.node.destroy_timer, timer)


def _xyz(point: Point) -> tuple[float, float, float]:
    return point.x, point.y, point.z


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    folder = tmp_path_factory.mktemp("closed_loop")
    robot = str(patient(folder / "patient"))
    with stack(folder, robot=robot, servo=(), leeloo_sim=()) as started:
        yield started


@pytest.fixture(scope="module")
def clients(running: Stack) -> Arm:
    return Arm(running)


@pytest.fixture
def arm(clients: Arm) -> Iterator[Arm]:
    clients.strategy("emulator")
    clients.robot.wait_rest()
    yield clients
    clients.robot.wait_rest()  # a session of commands has ended by then: one that somebody else ends is missed until they pause
    clients.choose(CLASSIC)


def on_target(goal: Sent) -> Any:
    """The first feedback on target."""
    return eventually(
        lambda: next((report for report in goal.feedback if report.on_target), None), "the robot is on target"
    )


def test_mpc_follows_beyond_on_target_until_cancelled(arm: Arm) -> None:
    arm.choose(MPC)
    there = arm.beside(y=0.08)
    goal = arm.execute.send(target_pose=there)
    assert goal.accepted
    report = on_target(goal)
    assert goal.feedback[0].state == "TRACKING"
    assert (report.state, report.hold_count >= 1, report.step_progression) == ("ON_TARGET", True, 1.0)
    assert 0.0 <= report.position_error < 0.01
    assert 0.0 <= report.orientation_error < 0.05
    assert len(report.joint_command.position) == 6
    arm.lead_to(arm.beside(y=-0.05, z=0.05))
    goal.cancel()
    status, result = goal.ended()
    assert (status, result.success) == (CANCELED, False)
    assert arm.robot.rests()
    assert {one.state for one in goal.feedback} == {"TRACKING", "ON_TARGET"}


def test_retarget_without_a_target_holds_and_follows_poses(arm: Arm) -> None:
    arm.choose(RETARGET)
    start = arm.tip()
    markers, paths = arm.ros.heard(Marker, "/mpc_goal_marker"), arm.ros.heard(Path, "/mpc_predicted_path")
    goal = arm.execute.send()
    assert goal.accepted
    on_target(goal)
    assert arm.away_from(start) < 0.002
    x, y, z = _xyz(start.position)
    poses = [Pose(position=Point(x=x, y=y, z=z + 0.001 * step), orientation=start.orientation) for step in range(1, 81)]
    with arm.commanding("mpc_goal", *poses):
        eventually(lambda: arm.away_from(poses[-1]) < 0.005, "the tip follows the poses")
    path = eventually(lambda: paths and paths[-1], "the path is published")
    assert path.header.frame_id == "base_link"
    assert path.poses
    assert any(marker.pose.position.z > start.position.z + 0.05 for marker in markers)
    goal.cancel()
    assert goal.ended()[0] == CANCELED
    eventually(lambda: markers[-1].action == Marker.DELETEALL, "the marker is taken away")


def test_mpc_move_ends_on_target(arm: Arm) -> None:
    there = arm.beside(x=-0.06)
    goal = arm.move.send(target_pose=there)
    status, result = goal.ended()
    assert (status, result.success) == (SUCCEEDED, True), result.message
    assert result.message.startswith("Target reached: ")
    assert arm.away_from(there) < 0.012
    assert goal.feedback[-1].step_progression == 1.0
    assert len(goal.feedback[-1].joint_command.position) == 6


def test_mpc_move_gives_up_after_its_steps_and_says_what_is_left(arm: Arm) -> None:
    arm.ros.configure(max_mpc_iterations=10, mpc_step_dt=0.05)
    try:
        status, result = arm.move.send(target_pose=arm.beside(z=3.0)).ended()
    finally:
        arm.ros.configure(max_mpc_iterations=1000, mpc_step_dt=0.03)
    assert status == ABORTED
    assert "max_mpc_iterations" in result.message
    assert " 0.0 mm" not in result.message
    assert arm.robot.rests()


def test_goals_unfit_for_closed_loop_are_refused_by_field(arm: Arm) -> None:
    status, result = arm.move.send().ended()
    assert (status, "(target_pose)" in result.message) == (ABORTED, True)
    arm.choose(MPC)
    status, result = arm.execute.send(target_joint_positions=[0.0] * 6).ended()
    assert (status, "(target_joint_positions)" in result.message) == (ABORTED, True)
    planned = arm.ros.call(TrajectoryGeneration, "generate_trajectory", target_pose=arm.tip())
    assert not planned.success
    assert "makes no trajectory" in planned.message
    assert arm.robot.rests()


@pytest.mark.slow  # as of any goal, in one_stack
def test_with_preempt_a_second_goal_replaces_a_closed_loop_one(arm: Arm) -> None:
    arm.choose(MPC)
    first = arm.execute.send(target_pose=arm.tip())
    assert first.accepted
    on_target(first)
    assert not arm.move.send(target_pose=arm.tip()).accepted
    arm.ros.configure(preempt=True)
    try:
        second = arm.move.send(target_pose=arm.beside(y=0.03))
        assert second.ended()[0] == SUCCEEDED
    finally:
        arm.ros.configure(preempt=False)
    status, result = first.ended()
    assert status == ABORTED
    assert "another goal" in result.message


def test_a_pose_on_mpc_goal_without_a_closed_loop_is_reported(arm: Arm) -> None:
    said = arm.ros.heard(Log, "/rosout", 100)
    there = arm.beside(y=0.05)
    eventually(
        lambda: arm.mpc_goal.publish(there) or any("mpc_goal moves nothing" in line.msg for line in said), "it is said"
    )
    assert arm.robot.rests()


def test_joint_speed_carries_a_closed_loop_joint_trajectory_not(arm: Arm) -> None:
    arm.strategy("joint_speed")
    there = arm.beside(z=0.05)
    status, result = arm.move.send(target_pose=there).ended()
    assert status == SUCCEEDED, result.message
    arm.robot.wait_rest()
    arm.strategy("joint_trajectory")
    status, result = arm.move.send(target_pose=arm.tip()).ended()
    assert status == ABORTED
    assert "joint_trajectory" in result.message
    assert "switch to another" in result.message


@pytest.mark.parametrize("frame", sampled("link_6", "base_link"))
def test_a_twist_moves_the_tip_in_its_frame_and_times_out(arm: Arm, frame: str) -> None:
    statuses = arm.ros.heard(Int8, f"{NODE}/servo_status")
    start = arm.tip()
    command = TwistStamped()
    command.header.frame_id = frame
    command.twist.linear = Vector3(z=-0.05)
    with arm.commanding("delta_twist_cmds", command) as pause:
        eventually(lambda: arm.away_from(start) > 0.02, "the tip moves")
        pause()
        arm.robot.wait_rest()
    assert {report.data for report in statuses} - {INVALID} == {NO_WARNING}  # a busy machine pauses sessions
    moved = np.subtract(_xyz(arm.tip().position), _xyz(start.position))
    axis = np.array((0.0, 0.0, -1.0)) if frame == "base_link" else -_z_axis(start)
    assert moved @ axis > 0.98 * np.linalg.norm(moved)


def test_joint_speeds_and_poses_move_the_robot(arm: Arm) -> None:
    before = arm.robot.joints()
    with arm.commanding("delta_joint_cmds", JointState(name=["joint1"], velocity=[0.2])) as pause:
        eventually(lambda: arm.robot.joints()[0] > before[0] + 0.03, "joint_1 moves")
        there = arm.beside(x=-0.04)
        pause()
    with arm.commanding("pose_target_cmds", PoseStamped(pose=there)):
        eventually(lambda: arm.away_from(there) < 0.003, "the tip is at the pose")
    assert np.allclose(before[1:3], arm.robot.joints()[1:3], atol=0.2)


def test_a_trajectory_of_a_policy_is_followed_when_it_says_so(arm: Arm) -> None:
    before, names = arm.robot.joints(), list(ROBOT.descriptor.joints)
    chunk = JointTrajectory(joint_names=names[::-1])
    chunk.header.stamp = ros_time(time.time() + 1.0)
    for k in range(20):
        turned = [before[0] + 0.15 * (1.0 - np.cos(np.pi * k / 19)) / 2, *before[1:]]
        chunk.points.append(JointTrajectoryPoint(positions=turned[::-1], time_from_start=ros_duration(k * 0.1)))
    with arm.commanding("joint_trajectory_cmds", chunk):
        eventually(lambda: abs(arm.robot.joints()[0] - before[0] - 0.15) < 0.003, "joint_1 is where the chunk ends")
    assert np.allclose(before[1:], arm.robot.joints()[1:], atol=1e-3)


def test_a_trajectory_of_other_joints_is_refused_in_the_status(arm: Arm) -> None:
    texts = arm.texts
    with arm.commanding("joint_trajectory_cmds", JointTrajectory(joint_names=["elbow"])):
        eventually(lambda: any("joint_names" in report.data for report in texts), "the joints are refused")
    assert arm.robot.rests()


def test_commands_that_are_none_are_refused_in_the_status(arm: Arm) -> None:
    statuses, texts = arm.ros.heard(Int8, f"{NODE}/servo_status"), arm.texts
    lost = TwistStamped()
    lost.header.frame_id = "camera"
    with arm.commanding("delta_twist_cmds", lost):
        eventually(lambda: any("camera" in report.data for report in texts), "the frame is refused")
    nothing = JointState(velocity=[float("nan")] * 6)
    with arm.commanding("delta_joint_cmds", nothing):
        eventually(lambda: any("velocity[0]" in report.data for report in texts), "the number is refused")
    assert {report.data for report in statuses} == {-1}
    assert arm.robot.rests()


def test_after_a_stop_commands_must_pause_before_they_count(arm: Arm) -> None:
    texts, before = arm.texts, len(arm.texts)
    start = arm.tip()
    command = TwistStamped()
    command.twist.linear = Vector3(z=0.03)
    with arm.commanding("delta_twist_cmds", command, heeding=False):
        eventually(lambda: arm.away_from(start) > 0.005, "the tip moves")
        arm.robot.bus.call(KEYS.cancel, CancelRequest(), timeout=PATIENCE)
        eventually(lambda: any(PAUSE in report.data for report in texts[before:]), "it is told")
        arm.robot.wait_rest()
        stopped, report = arm.robot.joints(), len(texts)
        arm.robot.plan()  # which takes longer than many commands
        assert arm.robot.joints() == stopped
        assert all(PAUSE in text.data for text in texts[report:])


def _z_axis(pose: Pose) -> np.ndarray:
    q = pose.orientation
    return np.array((2 * (q.x * q.z + q.w * q.y), 2 * (q.y * q.z - q.w * q.x), 1 - 2 * (q.x**2 + q.y**2)))
