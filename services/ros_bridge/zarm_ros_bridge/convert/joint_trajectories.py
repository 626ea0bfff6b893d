"""Trajectories of ROS clients as motions of the robot."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from time import time as unix_time
from typing import Any

import numpy as np

from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import Trajectory
from zarm_ros_bridge.convert.fields import finite
from zarm_ros_bridge.convert.joints import Positions, places_of
from zarm_ros_bridge.convert.times import NANOSECONDS
from zarm_trajectory.arrays import Array

MOST_POINTS = 100_000
_LATEST = 60.0
"""How long (s) after now a trajectory may begin."""
_START_TOLERANCE = 0.01
"""How far (rad) a joint may be from where a trajectory without duration has it."""


def trajectory_of(
    message: Any, joints: Sequence[str], present: Callable[[], Positions], field: str
) -> Trajectory | None:
    """The motion of a `trajectory_msgs/JointTrajectory`, of `joints` in this order; None if it has no duration, and the robot
    is there.

    A first point later than 0 is reached from the `present` positions, at rest. Points without velocities are passed on a cubic
    spline that begins and ends at rest; points without accelerations have those of the cubics to both sides, on average. Raises
    InvalidRequest.
    """
    count = len(message.points)
    if not 0 < count <= MOST_POINTS:
        raise InvalidRequest(f"{count} points; a trajectory has 1 to {MOST_POINTS}", field=f"{field}.points")
    places = places_of(message.joint_names, joints, f"{field}.joint_names")
    if unknown := [name for name in message.joint_names if name in places and name not in joints]:
        raise InvalidRequest(
            f"the robot has no joint {', '.join(unknown)}; it has {', '.join(joints)}", field=f"{field}.joint_names"
        )
    order = [places[joint] for joint in joints]
    time = np.array([_seconds(point.time_from_start) for point in message.points])
    position = _rows(message.points, "positions", order, field)
    if position is None:
        raise InvalidRequest("a point has no positions; give one for each joint", field=f"{field}.points")
    velocity = _rows(message.points, "velocities", order, field)
    acceleration = _rows(message.points, "accelerations", order, field) if velocity is not None else None
    if time[0] < 0.0 or np.any(np.diff(time) <= 0.0):
        raise InvalidRequest("time_from_start must increase from point to point", field=f"{field}.points")
    if time[0] > 0.0:
        time = np.concatenate(([0.0], time))
        position = np.concatenate((np.array(present())[None], position))
        velocity, acceleration = (
            None if rows is None else np.concatenate((np.zeros((1, len(order))), rows))
            for rows in (velocity, acceleration)
        )
    if len(time) < 2:
        off = np.abs(position[0] - present())
        if off.max() > _START_TOLERANCE:
            joint = joints[int(off.argmax())]
            raise InvalidRequest(
                f"the only point is at time 0, and {joint} is {off.max():.4f} rad from it; give it a time",
                field=f"{field}.points",
            )
        return None
    if velocity is None:
        velocity = _spline_velocities(time, position)
    if acceleration is None:
        acceleration = _mean_accelerations(time, position, velocity)
    return Trajectory(
        joint_names=tuple(joints),
        time=tuple(time.tolist()),
        position=tuple(map(tuple, position.tolist())),
        velocity=tuple(map(tuple, velocity.tolist())),
        acceleration=tuple(map(tuple, acceleration.tolist())),
    )


def starts_in(message: Any, field: str) -> float:
    """In how long (s) a `trajectory_msgs/JointTrajectory` begins by its stamp: 0 for one without, or that has begun. Raises InvalidRequest for one that is
    over, or begins more than a minute from now.
    """
    stamp = message.header.stamp
    begin, now = stamp.sec + stamp.nanosec / NANOSECONDS, unix_time()
    if not begin:
        return 0.0
    if begin + (_seconds(message.points[-1].time_from_start) if message.points else 0.0) < now:
        raise InvalidRequest("the trajectory ended before it came; send it earlier", field=f"{field}.header.stamp")
    if begin > now + _LATEST:
        raise InvalidRequest(
            f"the trajectory begins {begin - now:.0f} s from now; send it later", field=f"{field}.header.stamp"
        )
    return float(max(0.0, begin - now))


def _rows(points: Sequence[Any], name: str, order: Sequence[int], field: str) -> Array | None:
    """A row of each point, in the order of the joints; None if a point has none."""
    rows = []
    for i, point in enumerate(points):
        values = getattr(point, name)
        if not len(values):
            return None
        if len(values) != len(order):
            raise InvalidRequest(
                f"{len(values)} {name} for {len(order)} joints; give one for each", field=f"{field}.points[{i}].{name}"
            )
        rows.append([finite(values[place], f"{field}.points[{i}].{name}[{place}]") for place in order])
    return np.array(rows)


def _spline_velocities(time: Array, position: Array) -> Array:
    """Velocities (n, joints) of the cubic spline through the points that is at rest at both ends and continuous in acceleration."""
    velocity = np.zeros_like(position)
    step = np.diff(time)
    if len(step) < 2:
        return velocity
    slope = np.diff(position, axis=0) / step[:, None]
    matrix = np.diag(2.0 * (step[:-1] + step[1:]))
    matrix += np.diag(step[2:], -1) + np.diag(step[:-2], 1)
    right = 3.0 * (step[1:, None] * slope[:-1] + step[:-1, None] * slope[1:])
    velocity[1:-1] = np.linalg.solve(matrix, right)
    return velocity


def _mean_accelerations(time: Array, position: Array, velocity: Array) -> Array:
    """Accelerations (n, joints) at the points: the mean of those of the cubics to both sides, 0 at the ends."""
    step = np.diff(time)[:, None]
    slope = np.diff(position, axis=0) / step
    begin = (6.0 * slope - 4.0 * velocity[:-1] - 2.0 * velocity[1:]) / step
    end = (-6.0 * slope + 2.0 * velocity[:-1] + 4.0 * velocity[1:]) / step
    acceleration = np.zeros_like(position)
    acceleration[1:-1] = (end[:-1] + begin[1:]) / 2.0
    return acceleration


def _seconds(duration: Any) -> float:
    return float(duration.sec + duration.nanosec / NANOSECONDS)
