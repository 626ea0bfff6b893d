"""Trajectories for tests of the executor: no planner needed."""

from __future__ import annotations

import math
import shutil
from pathlib import Path

import numpy as np

from zarm_contract.keys import Keys
from zarm_contract.messages import Plan, PlanTimings, Pose, Trajectory
from zarm_contract.robot import RobotDescription, find_robot, load_robot
from zarm_trajectory.rate_bounds import RateLimits
from zarm_trajectory.trajectory import TimedTrajectory

ROBOT = load_robot("doosan_m1013")
"""The robot used in tests."""
RATE_LIMITS = RateLimits.of(ROBOT.descriptor)
KEYS = Keys(ROBOT.descriptor.name)
HOME = np.array(ROBOT.descriptor.home)
SCENE = "1-5be0c1d2f3a4"
"""A revision of the scene."""


def rest_to_rest(
    goal: np.ndarray,
    start: np.ndarray = HOME,
    *,
    robot: RobotDescription = ROBOT,
    slower: float = 1.0,
    dt: float = 0.01,
) -> Trajectory:
    """From rest to rest on a straight line in joint space, as fast as the limits allow, or `slower` times as long.

    The minimum-jerk polynomial 10u^3 - 15u^4 + 6u^5 over the time T peaks at 15/8 d/T and 10/sqrt(3) d/T^2.
    """
    distance = goal - start
    limits = robot.descriptor.cspace
    duration = slower * max(
        float(np.max(np.abs(distance) * 15 / 8 / limits.velocity)),
        float(np.max(np.sqrt(np.abs(distance) * 10 / math.sqrt(3) / limits.acceleration))),
        0.1,
    )
    time = np.linspace(0.0, duration, max(2, math.ceil(duration / dt) + 1))
    u = time[:, None] / duration
    return Trajectory(
        joint_names=robot.descriptor.joints,
        time=tuple(time.tolist()),
        position=rows(start + distance * (10 * u**3 - 15 * u**4 + 6 * u**5)),
        velocity=rows(distance * (30 * u**2 - 60 * u**3 + 30 * u**4) / duration),
        acceleration=rows(distance * (60 * u - 180 * u**2 + 120 * u**3) / duration**2),
    )


def curved_path(seed: int, samples: int = 200) -> TimedTrajectory:
    """Joints that swing back and forth from rest to rest, one of them at its limit at least once."""
    random = np.random.default_rng(seed)
    u = np.polynomial.Polynomial([0.0, 1.0])
    bell = 64 * u**3 * (1 - u) ** 3
    line = 10 * u**3 - 15 * u**4 + 6 * u**5
    curves = []
    for start in HOME:
        wave = np.polynomial.Chebyshev(random.uniform(-1.0, 1.0, 6), domain=[0.0, 1.0]).convert(
            kind=np.polynomial.Polynomial
        )
        curves.append(start + random.uniform(-1.0, 1.0) * line + bell * wave)
    grid = np.linspace(0.0, 1.0, samples)
    position, velocity, acceleration = (
        np.stack([curve.deriv(order)(grid) if order else curve(grid) for curve in curves], axis=1) for order in range(3)
    )
    duration = float(np.sqrt(np.max(np.abs(acceleration) / ROBOT.descriptor.cspace.acceleration)))
    return TimedTrajectory(grid * duration, position, velocity / duration, acceleration / duration**2)


def trapezoid(
    goal: np.ndarray,
    start: np.ndarray = HOME,
    *,
    robot: RobotDescription = ROBOT,
    share: float = 1.0,
    dt: float = 0.02,
    ramp: float | None = None,
) -> Trajectory:
    """From rest to rest on a straight line in joint space as a planner times it: at `share` of the acceleration limit
    after `ramp` s, by default as soon as the jerk limit allows, then at the velocity limit, or half way and back if the
    line is too short for that.
    """
    distance, limits = goal - start, robot.descriptor.cspace
    way = np.maximum(np.abs(distance), 1e-9)
    acceleration, jerk = share * float(np.min(limits.acceleration / way)), float(np.min(limits.jerk / way))
    if ramp is None:
        ramp = acceleration / jerk
    else:
        jerk = acceleration / ramp
    velocity = min(float(np.min(limits.velocity / way)), math.sqrt(acceleration) * 0.9)
    rising = max(velocity / acceleration - ramp, 0.0)
    cruise = 1.0 / velocity - rising - 2 * ramp
    rows_ = [(0.0, 0.0, 0.0, 0.0)]
    for length, change in (
        (ramp, jerk),
        (rising, 0),
        (ramp, -jerk),
        (cruise, 0),
        (ramp, -jerk),
        (rising, 0),
        (ramp, jerk),
    ):
        count = math.ceil(length / dt)
        for _ in range(count):
            t, s, v, a = rows_[-1]
            h = length / count
            rows_.append(
                (t + h, s + v * h + a * h**2 / 2 + change * h**3 / 6, v + a * h + change * h**2 / 2, a + change * h)
            )
    time, s, v, a = np.array(rows_).T
    v[-1] = a[-1] = 0.0
    return Trajectory(
        joint_names=robot.descriptor.joints,
        time=tuple(time.tolist()),
        position=rows(start + np.outer(s / s[-1], distance)),
        velocity=rows(np.outer(v / s[-1], distance)),
        acceleration=rows(np.outer(a / s[-1], distance)),
    )


def descriptor_at(control_rate: float, folder: Path) -> Path:
    """The descriptor of the tests' robot with another control rate (Hz), in a separate folder."""
    return with_execution(folder, f"control_rate: {control_rate}")


def patient(folder: Path, robot: RobotDescription = ROBOT) -> Path:
    """The descriptor of a robot that has 1 s to report its joints, in a separate folder: for tests that move it through
    a driver on a busy machine, and do not test how soon its silence is noticed.
    """
    return with_execution(folder, "joint_state_timeout: 1.0", robot)


def forgiving(folder: Path) -> RobotDescription:
    """The same robot, whose faults are left by the next goal."""
    return load_robot(str(with_execution(folder, "faults: clear_at_rest")))


def with_execution(folder: Path, execution: str, robot: RobotDescription = ROBOT) -> Path:
    """The descriptor of a robot with these settings under `execution`, in a separate folder."""
    folder.mkdir(parents=True)
    name = robot.descriptor.name
    descriptor = folder / f"{name}.yaml"
    descriptor.write_text(f"{find_robot(name).read_text()}\nexecution: {{{execution}}}\n")
    shutil.copy(robot.urdf_path, folder)
    return descriptor


def rows(array: np.ndarray) -> tuple[tuple[float, ...], ...]:
    """A (N, J) array in message form."""
    return tuple(tuple(row) for row in array.tolist())


def moved(*distances: float, start: np.ndarray = HOME) -> np.ndarray:
    """`start` with the first joints moved by these distances (rad)."""
    goal = start.copy()
    goal[: len(distances)] += distances
    return goal


def plan(
    plan_id: str,
    trajectory: Trajectory,
    *,
    revision: str = SCENE,
    robot: RobotDescription = ROBOT,
    robot_hash: str = "",
) -> Plan:
    """A Plan as the planner publishes it."""
    return Plan(
        plan_id=plan_id,
        robot=robot.descriptor.name,
        robot_hash=robot_hash or robot.hash,
        scene_revision=revision,
        trajectory=trajectory,
        tip=Pose(position=(0.0, 0.0, 0.0)),
        clearance=1.0,
        resolution=0.005,
        path_length=1.0,
        timings=PlanTimings(ik=0.0, search=0.0, shortcut=0.0, timing=0.0, verify=0.0, optimize=0.0, total=0.0),
    )
