"""Trajectories."""

from __future__ import annotations

import math

import numpy as np
from sensor_msgs.msg import JointState as RosJointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from zarm_contract.messages import DriverCommand, Trajectory
from zarm_ros_bridge.convert.times import ros_duration
from zarm_trajectory.trajectory import TimedTrajectory


def ros_joint_trajectory(motion: DriverCommand | Trajectory) -> JointTrajectory:
    """A motion that begins on arrival (stamp 0). A command without points means stop."""
    points = []
    for index, at in enumerate(motion.time):
        point = JointTrajectoryPoint(
            positions=list(motion.position[index]),
            velocities=list(motion.velocity[index]) if motion.velocity else [],
            accelerations=list(motion.acceleration[index]) if motion.acceleration else [],
            time_from_start=ros_duration(at),
        )
        points.append(point)
    return JointTrajectory(joint_names=list(motion.joint_names), points=points)


def ros_joint_states(trajectory: Trajectory, dt: float) -> list[RosJointState]:
    """Positions and velocities every `dt` s from the start of a motion to its end at rest.

    Each is a shallow copy of the first, sharing what never changes: the constructor, which makes every field anew,
    takes as long as all the rest.
    """
    common = RosJointState(name=list(trajectory.joint_names))
    fields = [(slot, getattr(common, slot)) for slot in RosJointState.__slots__]
    motion = TimedTrajectory.of(trajectory, trajectory.joint_names)
    count = math.ceil(motion.duration / dt - 1e-9) + 1
    positions, velocities, _ = motion.sample(np.minimum(np.arange(count) * dt, motion.duration)).tolist()
    messages = []
    for position, velocity in zip(positions, velocities, strict=True):
        message = RosJointState.__new__(RosJointState)
        for slot, value in fields:
            setattr(message, slot, value)
        message.position, message.velocity = position, velocity
        messages.append(message)
    return messages
