"""A swinging target, as chunks streamed by a client that follows it."""

from __future__ import annotations

import math

import numpy as np

from support.trajectories import HOME
from zarm_contract.messages import Trajectory
from zarm_contract.robot import RobotDescription
from zarm_trajectory.arrays import Array
from zarm_trajectory.trajectory import TimedTrajectory

AMPLITUDE, PERIOD = 0.3, 4.0
STEP = 0.02


def target(time: float) -> tuple[float, float, float]:
    """Where the target is (rad from home) at `time` s, its velocity and acceleration; at rest at 0."""
    w = 2 * math.pi / PERIOD
    half = AMPLITUDE / 2
    return half * (1 - math.cos(w * time)), half * w * math.sin(w * time), half * w * w * math.cos(w * time)


def chunk(start: float, horizon: float = 0.2, braking: float = 0.8, *, off: float = 0.0) -> TimedTrajectory:
    """The first joint with the target for `horizon` s from `start` on, displaced by `off` rad, then to rest in
    `braking` s.
    """
    times = [index * STEP for index in range(round(horizon / STEP) + 1)]
    states = [target(start + time) for time in times]
    q, v, a = states[-1]
    for index in range(1, round(braking / STEP) + 1):
        # velocity (v + b s)(1 - s)^2, which begins with acceleration a and ends at rest
        s, b = index * STEP / braking, a * braking + 2 * v
        times.append(horizon + index * STEP)
        velocity = (v + b * s) * (1 - s) ** 2
        acceleration = (b * (1 - s) ** 2 - 2 * (v + b * s) * (1 - s)) / braking
        position = q + braking * (v * (1 - (1 - s) ** 3) / 3 + b * (s**2 / 2 - 2 * s**3 / 3 + s**4 / 4))
        states.append((position, velocity, acceleration))
    moving = np.array(states)
    position, velocity, acceleration = (np.zeros((len(times), len(HOME))) for _ in range(3))
    position += HOME
    position[:, 0] += moving[:, 0] + off
    velocity[:, 0], acceleration[:, 0] = moving[:, 1], moving[:, 2]
    return TimedTrajectory(np.array(times), position, velocity, acceleration)


def as_message(path: TimedTrajectory, robot: RobotDescription) -> Trajectory:
    """A path in message form."""

    def rows(array: Array) -> tuple[tuple[float, ...], ...]:
        return tuple(map(tuple, array.tolist()))

    return Trajectory(
        joint_names=robot.descriptor.joints,
        time=tuple(path.time.tolist()),
        position=rows(path.position),
        velocity=rows(path.velocity),
        acceleration=rows(path.acceleration),
    )
