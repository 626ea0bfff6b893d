"""What must hold before a robot moves; each check that fails is an error that says which joint, how far off, and what to do."""

from __future__ import annotations

import numpy as np

from zarm_contract.errors import ExecutionRefused, InvalidRequest
from zarm_contract.messages import Trajectory
from zarm_contract.robot import Execution, Robot
from zarm_executor.path import Array, Path
from zarm_executor.strategies.base import Measured

LIMIT_TOLERANCE = 1.01
"""Velocity and acceleration may be above their limits by this factor: what interpolation adds between samples."""
POSITION_TOLERANCE = 1e-4
"""Positions may be outside their limits by this much, rad: rounding, and interpolation between samples."""
REST_VELOCITY = 1e-3
"""A motion that starts and ends slower than this (rad/s) starts and ends at rest."""
_HALVINGS = 16


def executable(trajectory: Trajectory, robot: Robot) -> Path:
    """The path of a trajectory that this robot can follow.

    Raises InvalidRequest (joints, times, rest at both ends) or ExecutionRefused (`limit_violated`, by position,
    velocity or acceleration, between samples too).
    """
    path = Path.of(trajectory, robot.descriptor.joints)
    with np.errstate(all="ignore"):  # absurd numbers overflow to inf and NaN, which no comparison below lets pass
        _rest(path, robot.descriptor.joints)
        _limits(path, robot)
    return path


def startable(path: Path, measured: Measured | None, now: float, robot: Robot) -> Path:
    """The path as it runs from where the robot stands, `measured` on the clock that reads `now`.

    A revolute joint may stand whole turns from where the path starts: then the path is shifted by them, where the joint's
    range allows. What is left, at most `start_tolerance`, is moved first, slowly enough for every limit.

    Raises ExecutionRefused: `no_joint_state` or `start_state_mismatch`.
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
    path = path.shifted(_turns(path, measured.position, robot))
    for joint, is_at, starts_at in zip(joints, measured.position, path.start, strict=True):
        if not abs(is_at - starts_at) <= execution.start_tolerance:
            raise ExecutionRefused(
                f"{joint} is at {is_at:.4f} rad but the motion starts at {starts_at:.4f} rad, {abs(is_at - starts_at):.4f} "
                f"rad away (start_tolerance {execution.start_tolerance:g}); plan again from where the robot is",
                code="start_state_mismatch",
                joint=joint,
            )
    limits = robot.descriptor.cspace
    return path.approached_from(measured.position, np.array(limits.velocity), np.array(limits.acceleration))


def _fresh(measured: Measured | None, now: float, execution: Execution) -> Measured:
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


def _turns(path: Path, position: Array, robot: Robot) -> Array:
    """Whole turns (J,) in rad, by which the path must be shifted to start nearest to `position` inside the limits."""
    turning = {joint.name for joint in robot.urdf.joint_of_child.values() if joint.type in ("revolute", "continuous")}
    turns = 2 * np.pi * np.round((position - path.start) / (2 * np.pi))
    lowest, highest = path.position.min(axis=0) + turns, path.position.max(axis=0) + turns
    allowed = (lowest >= np.array(robot.lower) - POSITION_TOLERANCE) & (
        highest <= np.array(robot.upper) + POSITION_TOLERANCE
    )
    allowed &= np.array([joint in turning for joint in robot.descriptor.joints])
    return np.where(allowed, turns, 0.0)


def _rest(path: Path, joints: tuple[str, ...]) -> None:
    for row, end in ((0, "start"), (-1, "end")):
        for joint, speed in zip(joints, np.abs(path.velocity[row]), strict=True):
            if not speed <= REST_VELOCITY:
                raise InvalidRequest(
                    f"{joint} moves at {speed:.3g} rad/s at the {end} of the motion; a motion starts and ends at rest",
                    field="trajectory.velocity",
                )


def _limits(path: Path, robot: Robot) -> None:
    joints, cspace = robot.descriptor.joints, robot.descriptor.cspace
    position = np.moveaxis(path.coefficients, 1, 0)  # (6, segments, J)
    velocity = _derivative(position) / path.steps[:, None]
    acceleration = _derivative(velocity) / path.steps[:, None]
    lower, upper = np.array(robot.lower), np.array(robot.upper)
    middle, reach = (lower + upper) / 2, (upper - lower) / 2 + POSITION_TOLERANCE
    for name, unit, curve, offset, limit in (
        ("position", "rad", position, middle, reach),
        ("velocity", "rad/s", velocity, np.zeros_like(middle), np.array(cspace.velocity) * LIMIT_TOLERANCE),
        (
            "acceleration",
            "rad/s^2",
            acceleration,
            np.zeros_like(middle),
            np.array(cspace.acceleration) * LIMIT_TOLERANCE,
        ),
    ):
        values = _extremes(curve)  # (points, segments, J)
        if np.all(np.abs(values - offset) <= limit):
            continue
        excess = np.nan_to_num(np.abs(values - offset) / limit, nan=np.inf)
        point, segment, joint = np.unravel_index(int(excess.argmax()), excess.shape)
        bounds = (
            f"{lower[joint]:g} to {upper[joint]:g}" if name == "position" else f"{limit[joint] / LIMIT_TOLERANCE:g}"
        )
        raise ExecutionRefused(
            f"the {name} of {joints[joint]} reaches {values[point, segment, joint]:.4g} {unit} near "
            f"{path.time[segment]:.2f} s, outside its limit {bounds}; plan again with the limits of this robot",
            code="limit_violated",
            joint=joints[joint],
            field=f"trajectory.{name}",
        )


def _derivative(polynomials: Array) -> Array:
    """Coefficients (D, ...), lowest power first, of the derivatives of polynomials (D+1, ...)."""
    powers = np.arange(1, len(polynomials)).reshape(-1, *(1,) * (polynomials.ndim - 1))
    slope: Array = polynomials[1:] * powers
    return slope


def _value(polynomials: Array, u: Array) -> Array:
    result: Array = np.zeros_like(u) + polynomials[-1]
    for coefficient in polynomials[-2::-1]:
        result = result * u + coefficient
    return result


def _extremes(polynomials: Array) -> Array:
    """Values (D+1, ...) of polynomials (D+1, ...) on [0, 1], their least and greatest among them."""
    return _value(polynomials, _ends_and_turns(polynomials))


def _ends_and_turns(polynomials: Array) -> Array:
    """Points (D+1, ...) in [0, 1], in order: both ends, and each at which a polynomial of degree D turns.

    Between two points at which its slope turns the slope is monotone, so bisection finds the one zero it may have there.
    Where it has none the bisection ends at a border of the interval, which does no harm.
    """
    ends = np.zeros_like(polynomials[:1]), np.ones_like(polynomials[:1])
    if len(polynomials) == 2:
        return np.concatenate(ends)
    slope = _derivative(polynomials)
    knots = _ends_and_turns(slope)
    low, high = knots[:-1], knots[1:]
    sign = np.sign(_value(slope, low))
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        before = np.sign(_value(slope, middle)) == sign
        low, high = np.where(before, middle, low), np.where(before, high, middle)
    return np.concatenate((ends[0], low, ends[1]))
