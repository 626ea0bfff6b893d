"""Checks before motion; each failure names the joint, how far off it is, and what to do."""

from __future__ import annotations

import numpy as np

from zarm_contract.descriptor import ExecutionSettings
from zarm_contract.errors import ExecutionRefused, InvalidRequest
from zarm_contract.messages import Trajectory
from zarm_contract.robot import RobotDescription
from zarm_executor.strategies.base import Measured
from zarm_trajectory.arrays import Array
from zarm_trajectory.limits import POSITION_TOLERANCE, Limits
from zarm_trajectory.trajectory import TimedTrajectory

REST_VELOCITY = 1e-3
"""A motion that starts and ends slower than this (rad/s) starts and ends at rest."""


def executable(message: Trajectory, robot: RobotDescription) -> TimedTrajectory:
    """The trajectory of a message that this robot can follow.

    Raises InvalidRequest (joints, times, rest at both ends) or ExecutionRefused (`limit_violated`, by position,
    velocity or acceleration, between samples too).
    """
    trajectory = TimedTrajectory.of(message, robot.descriptor.joints)
    with np.errstate(all="ignore"):  # absurd numbers overflow to inf and NaN; the comparisons below reject them
        _rest(trajectory, robot.descriptor.joints, (0, -1))
        Limits.of(robot).check(trajectory)
    return trajectory


def continuation(message: Trajectory, robot: RobotDescription, turns: Array) -> TimedTrajectory:
    """The trajectory of a message, shifted by `turns` (J,) rad, for this robot to continue on while moving; it ends at
    rest.

    Raises what `executable` raises.
    """
    trajectory = TimedTrajectory.of(message, robot.descriptor.joints).shifted(turns)
    with np.errstate(all="ignore"):
        _rest(trajectory, robot.descriptor.joints, (-1,))
        Limits.of(robot).check(trajectory)
    return trajectory


def startable(
    trajectory: TimedTrajectory, measured: Measured | None, now: float, robot: RobotDescription
) -> TimedTrajectory:
    """The trajectory as it runs from the robot's position, `measured` on the clock that reads `now`.

    A revolute joint may be whole turns away from the start of the path: the path is then shifted by these turns if the
    joint's range allows. The remaining offset, at most `start_tolerance`, is moved first, slowly enough for every
    limit.

    Raises ExecutionRefused: `no_joint_state` or `start_state_mismatch`.
    """
    trajectory, at = placed(trajectory, measured, now, robot)
    limits = robot.descriptor.cspace
    return trajectory.approached_from(at.position, *map(np.array, (limits.velocity, limits.acceleration, limits.jerk)))


def placed(
    trajectory: TimedTrajectory, measured: Measured | None, now: float, robot: RobotDescription
) -> tuple[TimedTrajectory, Measured]:
    """The trajectory, shifted by whole turns so that the robot is within `start_tolerance` of its start; and the
    robot's state.

    Raises what `startable` raises.
    """
    execution, joints = robot.descriptor.execution, robot.descriptor.joints
    measured = _fresh(measured, now, execution)
    for joint, speed in zip(joints, np.abs(measured.velocity), strict=True):
        if not speed <= execution.stopped_velocity:
            raise ExecutionRefused(
                f"{joint} still moves at {speed:.3g} rad/s, more than stopped_velocity {execution.stopped_velocity:g}; "
                "wait until the robot rests",
                code="start_state_mismatch",
                joint=joint,
            )
    trajectory = trajectory.shifted(_turns(trajectory, measured.position, robot))
    for joint, is_at, starts_at in zip(joints, measured.position, trajectory.start, strict=True):
        if not abs(is_at - starts_at) <= execution.start_tolerance:
            raise ExecutionRefused(
                f"{joint} is at {is_at:.4f} rad but the motion starts at {starts_at:.4f} rad, {abs(is_at - starts_at):.4f} "
                f"rad away (start_tolerance {execution.start_tolerance:g}); plan again from where the robot is",
                code="start_state_mismatch",
                joint=joint,
            )
    return trajectory, measured


def _fresh(measured: Measured | None, now: float, execution: ExecutionSettings) -> Measured:
    remedy = "check that the robot's driver runs and publishes its joints"
    if measured is None:
        raise ExecutionRefused(f"the robot has not reported its joints yet; {remedy}", code="no_joint_state")
    if not now - measured.time <= execution.joint_state_timeout:
        raise ExecutionRefused(
            f"the robot last reported its joints {now - measured.time:.2f} s ago (joint_state_timeout "
            f"{execution.joint_state_timeout:g} s); {remedy}",
            code="no_joint_state",
        )
    return measured


def _turns(trajectory: TimedTrajectory, position: Array, robot: RobotDescription) -> Array:
    """Whole turns (J,) in rad, by which the path must be shifted to start nearest to `position` inside the limits."""
    turning = {joint.name for joint in robot.urdf.joint_of_child.values() if joint.type in ("revolute", "continuous")}
    turns = 2 * np.pi * np.round((position - trajectory.start) / (2 * np.pi))
    lowest, highest = trajectory.position.min(axis=0) + turns, trajectory.position.max(axis=0) + turns
    allowed = (lowest >= np.array(robot.lower) - POSITION_TOLERANCE) & (
        highest <= np.array(robot.upper) + POSITION_TOLERANCE
    )
    allowed &= np.array([joint in turning for joint in robot.descriptor.joints])
    return np.where(allowed, turns, 0.0)


def _rest(trajectory: TimedTrajectory, joints: tuple[str, ...], rows: tuple[int, ...]) -> None:
    for row in rows:
        end = "start" if row == 0 else "end"
        for joint, speed in zip(joints, np.abs(trajectory.velocity[row]), strict=True):
            if not speed <= REST_VELOCITY:
                raise InvalidRequest(
                    f"{joint} moves at {speed:.3g} rad/s at the {end} of the motion; a motion starts and ends at rest",
                    field="trajectory.velocity",
                )
