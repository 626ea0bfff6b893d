"""Motions."""

from __future__ import annotations

from array import array

from sensor_msgs.msg import JointState as RosJointState
from std_msgs.msg import Header
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from zarm_contract.messages import DriverCommand, Trajectory
from zarm_ros_bridge.convert.times import ros_duration
from zarm_ros_bridge.sampling import sampled


def ros_joint_trajectory(motion: DriverCommand | Trajectory) -> JointTrajectory:
    """A motion that begins when it arrives (stamp 0). A command without points is to stop."""
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
    """Positions and velocities every `dt` s from the start of a motion to its end, where it rests.

    What is the same in all of them they share: to make it anew for each takes as long as all the rest.
    """
    header, names, none = Header(), list(trajectory.joint_names), array("d")
    positions, velocities = sampled(trajectory, dt)
    return [
        RosJointState(
            header=header, name=names, position=array("d", position), velocity=array("d", velocity), effort=none
        )
        for position, velocity in zip(positions.tolist(), velocities.tolist(), strict=True)
    ]
