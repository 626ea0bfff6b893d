"""A driver's serialized joint states are read as what they are, however the one before was."""

from __future__ import annotations

import math
from typing import Any

from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState as RosJointState

from support.examples import examples
from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import JointState
from zarm_ros_bridge.convert.joints import driver_joint_state, ros_joint_state
from zarm_ros_bridge.drivers.joints import DriverJointStates

JOINTS = ("joint_1", "joint_2", "joint_3")

numbers = st.floats(allow_nan=True, allow_infinity=True) | st.floats(-3.0, 3.0)


@st.composite
def drivers(draw: st.DrawFn) -> list[RosJointState]:
    """Messages of which most are alike but for their numbers, as those of one driver are."""
    names = draw(st.permutations([*JOINTS, *draw(st.lists(st.text("gripö", min_size=1), max_size=2, unique=True))]))
    frames = st.sampled_from(["", "base", "wörld"])
    frame = draw(frames)
    messages = []
    for _ in range(draw(st.integers(2, 5))):
        odd = draw(st.integers(0, 4)) == 0
        row = st.lists(numbers if odd else st.floats(-3.0, 3.0), min_size=len(names), max_size=len(names))
        message = RosJointState(name=names[::-1] if odd else names, position=draw(row), velocity=draw(row))
        message.effort = draw(st.just([]) | row | st.lists(numbers, max_size=6))
        if odd:
            message.velocity = message.velocity[: draw(st.integers(0, len(names)))]
        message.header.frame_id = draw(frames) if odd else frame
        message.header.stamp.sec = draw(st.integers(1, 2**31 - 1))
        message.header.stamp.nanosec = draw(st.integers(0, 10**9 - 1))
        messages.append(message)
    return messages


def report(read: Any, message: Any) -> JointState | tuple[str | None, str]:
    """What `read` makes of it, or the field that it refuses and why."""
    try:
        state: JointState = read(message)
    except InvalidRequest as error:
        return error.problem.field, error.problem.message
    return state


@examples(0.5)
@given(drivers())
def test_a_serialized_message_is_read_as_the_message_itself(messages: list[RosJointState]) -> None:
    driver = DriverJointStates(JOINTS, JOINTS)
    for message in messages:
        assert report(driver.read, serialize_message(message)) == report(
            lambda whole: driver_joint_state(whole, JOINTS, JOINTS), message
        )


def test_efforts_are_passed_on_where_every_joint_has_one() -> None:
    for effort, expected in (
        ((5.0, 6.0, 7.0), (6.0, 7.0, 5.0)),
        ((5.0, math.nan, 7.0), None),
        ((), None),
        ((5.0,), None),
    ):
        driver = DriverJointStates(JOINTS, JOINTS)
        for _ in range(2):  # the second is read by the layout of the first
            names = ["joint_3", "joint_1", "joint_2"]
            message = RosJointState(name=names, position=[0.1] * 3, velocity=[0.0] * 3, effort=list(effort))
            message.header.stamp.sec = 1
            state = driver.read(serialize_message(message))
            assert dict(zip(state.joint_names, state.effort or (), strict=False)) == (
                {} if expected is None else dict(zip(JOINTS, expected, strict=True))
            )


def test_efforts_of_the_robot_are_in_its_joint_states_on_ros() -> None:
    rows = {"joint_names": JOINTS, "position": (0.1,) * 3, "velocity": (0.0,) * 3}
    assert list(ros_joint_state(JointState(stamp=1.0, effort=(5.0, 6.0, 7.0), **rows)).effort) == [5.0, 6.0, 7.0]
    assert list(ros_joint_state(JointState(stamp=1.0, **rows)).effort) == []


def test_after_a_number_that_is_none_the_next_message_is_read() -> None:
    driver = DriverJointStates(JOINTS, JOINTS)
    for position in (0.5, math.nan, 0.6):
        message = RosJointState(name=list(JOINTS), position=[0.1, position, 0.3], velocity=[0.0] * 3)
        message.header.stamp.sec = 1
        read = report(driver.read, serialize_message(message))
        assert read[0] == "position" if math.isnan(position) else read.position[1] == position
