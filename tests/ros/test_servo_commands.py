"""What the topics of MoveIt Servo may say, which of it comes late, and when a robot in closed loop is on target."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest
from geometry_msgs.msg import Pose, PoseStamped, Quaternion, TwistStamped, Vector3
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import ChunkAccepted, Clipped, ServoSession
from zarm_contract.robot import load_robot
from zarm_ros_bridge.convert.servo_commands import chunk_of, joint_speed_of, target_of, twist_of
from zarm_ros_bridge.convert.times import ros_duration
from zarm_ros_bridge.curobo.convergence import Approach
from zarm_ros_bridge.servo_commands import Punctuality

ROBOT = load_robot("doosan_m1013").descriptor


class Told:
    """A session that remembers what it was told."""

    def __init__(self) -> None:
        self.calls: list[tuple[Any, ...]] = []

    def twist(self, linear: Any, angular: Any, *, frame: str) -> None:
        self.calls.append((linear, angular, frame))

    def joint_speed(self, velocity: Any) -> None:
        self.calls.append(velocity)

    def to(self, pose: Any) -> None:
        self.calls.append((pose.position, pose.orientation))

    def follow(self, positions: Any, **others: Any) -> ChunkAccepted:
        self.calls.append((positions, others))
        over = Clipped(joint="joint_2", quantity="velocity", excess=0.25)
        return ChunkAccepted(limiting="free", clipped=(over,))


def twist(frame: str = "", x: float = 0.1) -> TwistStamped:
    message = TwistStamped()
    message.header.frame_id = frame
    message.twist.linear, message.twist.angular = Vector3(x=x), Vector3(z=0.2)
    return message


def jog(names: list[str], velocities: list[float], displacements: tuple[float, ...] = ()) -> SimpleNamespace:
    """As control_msgs/JointJog."""
    return SimpleNamespace(joint_names=names, velocities=velocities, displacements=displacements)


def base_only(header: Any, field: str) -> None:
    """A look-up of frames that knows the base frame alone."""
    if header.frame_id.removeprefix("/") not in ("", "base_link"):
        raise InvalidRequest(f"{header.frame_id} is unknown", field=f"{field}.frame_id")


def report(send: Any) -> Any:
    session = Told()
    send(session)
    return session.calls[0]


@pytest.mark.parametrize(
    ("frame", "meant"),
    [("", "base"), ("base_link", "base"), ("/base_link", "base"), ("link_6", "tool"), ("link6", "tool")],
)
def test_a_twist_is_along_the_axes_of_the_frame_of_its_header(frame: str, meant: str) -> None:
    assert report(twist_of(twist(frame), ROBOT, base_only)) == ((0.1, 0.0, 0.0), (0.0, 0.0, 0.2), meant)


def test_joint_speeds_are_by_name_and_the_others_stand_still() -> None:
    assert report(joint_speed_of(JointState(name=["joint2"], velocity=[0.3]), ROBOT, base_only)) == (
        0.0,
        0.3,
        0.0,
        0.0,
        0.0,
        0.0,
    )
    assert report(joint_speed_of(jog(["joint_6", "joint_1"], [0.6, 0.1]), ROBOT, base_only)) == (
        0.1,
        0.0,
        0.0,
        0.0,
        0.0,
        0.6,
    )
    assert report(joint_speed_of(JointState(velocity=[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]), ROBOT, base_only)) == (
        1,
        2,
        3,
        4,
        5,
        6,
    )


def trajectory(joints: tuple[str, ...] = ROBOT.joints, *rows: list[float], velocities: bool = False) -> JointTrajectory:
    """Points a tenth of a second apart."""
    message = JointTrajectory(joint_names=list(joints))
    for number, row in enumerate(rows):
        point = JointTrajectoryPoint(positions=row, time_from_start=ros_duration(0.1 * number))
        point.velocities = row if velocities else []
        message.points.append(point)
    return message


@pytest.mark.parametrize("velocities", [True, False])
def test_a_trajectory_becomes_a_chunk_and_reports_clipping(velocities: bool) -> None:
    rows = [[6.0, 5.0, 4.0, 3.0, 2.0, 1.0], [6.5, 5.5, 4.5, 3.5, 2.5, 1.5]]
    session = Told()
    said = chunk_of(trajectory(ROBOT.joints[::-1], *rows, velocities=velocities), ROBOT, base_only)(session)
    ((positions, others),) = session.calls
    assert positions == [[1.0, 2.0, 3.0, 4.0, 5.0, 6.0], [1.5, 2.5, 3.5, 4.5, 5.5, 6.5]]
    assert others == {"times": [0.0, 0.1], "start": None, "velocities": positions if velocities else None}
    assert said == "the velocity of joint_2 is 0.25 over its limit"


@pytest.mark.parametrize(
    ("read", "message", "field"),
    [
        (twist_of, twist("camera"), "header.frame_id"),
        (twist_of, twist(x=math.nan), "twist.linear.x"),
        (target_of, PoseStamped(pose=Pose(orientation=Quaternion(x=1.0, w=1.0))), "pose.orientation"),
        (joint_speed_of, JointState(name=["gripper"], velocity=[0.1]), "velocity"),
        (joint_speed_of, JointState(velocity=[0.1]), "velocity"),
        (joint_speed_of, JointState(name=["joint_1"], velocity=[math.inf]), "velocity[0]"),
        (joint_speed_of, jog(["joint_1"], [0.1], (0.1,)), "displacements"),
        (chunk_of, trajectory(("joint_1",), [0.0]), "joint_names"),
        (chunk_of, trajectory(ROBOT.joints, [0.0] * 5), "points[0].positions"),
        (chunk_of, trajectory(ROBOT.joints, [0.0] * 6, [math.nan] * 6), "points[1].positions[0]"),
    ],
)
def test_what_cannot_be_followed_is_refused_with_its_field(read: Any, message: Any, field: str) -> None:
    with pytest.raises(InvalidRequest) as refused:
        read(message, ROBOT, base_only)
    assert refused.value.problem.field == field


def test_a_pose_in_the_tip_frame_is_refused() -> None:
    message = PoseStamped()
    message.header.frame_id = "link_6"
    with pytest.raises(InvalidRequest, match="use base_link"):
        target_of(message, ROBOT, base_only)


def test_lateness_is_measured_against_the_same_topic() -> None:
    seen = Punctuality()
    ahead = 1e9  # of the clock that stamps, s
    assert not seen.late(ahead + 0.0, 5.0)
    assert not seen.late(ahead + 0.5, 5.55)
    assert seen.late(ahead + 0.6, 5.75)
    assert not seen.late(ahead + 0.8, 5.8)
    assert not seen.late(0.0, 9.0)  # no stamp


def test_on_target_needs_enough_steps_within_both_thresholds() -> None:
    approach = Approach(position=0.01, orientation=0.05, hold_steps=3, step=0.1)

    def judge(position: float, orientation: float, now: float) -> tuple[int, bool]:
        state = ServoSession(goal_id="g", position_error=position, orientation_error=orientation)
        found = approach.judge(state, now)
        return found.hold_count, found.on_target

    assert judge(0.1, 0.0, 0.0) == (0, False)
    assert judge(0.005, 0.06, 0.1) == (0, False)
    assert judge(0.005, 0.04, 0.2) == (1, False)
    assert judge(0.005, 0.04, 0.45) == (3, True)
    assert judge(0.02, 0.04, 0.5) == (0, False)
    assert judge(0.005, 0.04, 0.6) == (1, False)
    approach.begin()
    assert approach.judge(None, 0.7).on_target is False
