"""Messages of zarm as messages of ROS, and back."""

from __future__ import annotations

from builtin_interfaces.msg import Time
from sensor_msgs.msg import JointState as RosJointState

from zarm_contract.messages import JointState


def ros_time(stamp: float) -> Time:
    """Unix seconds as the time of ROS, to the nanosecond that a double can tell."""
    nanoseconds = round(stamp * 1e9)
    return Time(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)


def ros_joint_state(state: JointState) -> RosJointState:
    """Measured or previewed joints."""
    message = RosJointState(name=list(state.joint_names), position=list(state.position), velocity=list(state.velocity))
    message.header.stamp = ros_time(state.stamp)
    return message
