"""Trajectories."""

from __future__ import annotations

import math
from array import array
from typing import Any

import numpy as np
from sensor_msgs.msg import JointState as RosJointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from zarm_contract.messages import DriverCommand, Trajectory
from zarm_ros_bridge.convert.times import ros_duration
from zarm_trajectory.trajectory import TimedTrajectory


def ros_joint_trajectory(motion: DriverCommand | Trajectory) -> JointTrajectory:
    """A motion that begins on arrival (stamp 0). A command without points means stop."""
    points = _copies(JointTrajectoryPoint(), len(motion.time))
    for point, at, position in zip(points, motion.time, motion.position, strict=True):
        point.positions = array("d", position)
        point.time_from_start = ros_duration(at)
    for name, rows in (("velocities", motion.velocity), ("accelerations", motion.acceleration)):
        for point, row in zip(points, rows, strict=bool(rows)):
            setattr(point, name, array("d", row))
    return JointTrajectory(joint_names=list(motion.joint_names), points=points)


def ros_joint_states(trajectory: Trajectory, dt: float) -> list[RosJointState]:
    """Positions and velocities every `dt` s from the start of a motion to its end at rest."""
    motion = TimedTrajectory.of(trajectory, trajectory.joint_names)
    count = math.ceil(motion.duration / dt - 1e-9) + 1
    positions, velocities, _ = motion.sample(np.minimum(np.arange(count) * dt, motion.duration)).tolist()
    messages = _copies(RosJointState(name=list(trajectory.joint_names)), count)
    for message, position, velocity in zip(messages, positions, velocities, strict=True):
        message.position, message.velocity = position, velocity
    return messages


def _copies(message: Any, count: int) -> list[Any]:
    """Shallow copies, which share what is not set anew: the constructor, which makes every field, takes as long as all the rest."""
    kind: Any = type(message)
    fields = [(slot, getattr(message, slot)) for slot in kind.__slots__]
    copies = []
    for _ in range(count):
        copy = kind.__new__(kind)
        for slot, value in fields:
            setattr(copy, slot, value)
        copies.append(copy)
    return copies
