"""The motion that a robot has made, as it was measured."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from builtin_interfaces.msg import Duration
from moveit_msgs.msg import RobotTrajectory
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from zarm_contract.messages import JointState
from zarm_ros_bridge.engine import Engine

_MIN_INTERVAL = 0.02
"""Least time (s) between two points."""


@contextmanager
def measured(engine: Engine) -> Iterator[list[JointState]]:
    """The joint states that are published while the block runs, the newest last."""
    states: list[JointState] = []

    def receive(_: str, state: JointState) -> None:
        if not states or state.stamp >= states[-1].stamp + _MIN_INTERVAL:
            states.append(state)

    end = engine.bus.subscribe(engine.keys.joint_states, receive)
    try:
        yield states
    finally:
        end()


def executed_trajectory(states: list[JointState], frame: str) -> Any:
    """These joint states, the first at time 0."""
    trajectory = JointTrajectory()
    trajectory.header.frame_id = frame
    for state in states:
        trajectory.joint_names = list(state.joint_names)
        seconds, rest = divmod(round(1e9 * (state.stamp - states[0].stamp)), 10**9)
        time = Duration(sec=seconds, nanosec=rest)
        trajectory.points.append(
            JointTrajectoryPoint(positions=list(state.position), velocities=list(state.velocity), time_from_start=time)
        )
    return RobotTrajectory(joint_trajectory=trajectory)
