"""The kinds of live target, and the joint speeds that each means."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Literal, Self

import numpy as np

from zarm_contract.messages import PoseTolerance
from zarm_geometry.robot_model import RobotModel
from zarm_trajectory.arrays import Array
from zarm_trajectory.turns import whole_turns

GAIN = 8.0
"""Joint speed per distance, 1/s: a small distance halves every 0.09 s."""
_BRAKING = 0.45
"""Share of the acceleration used to brake an approach; below one half, so that `GAIN` never demands more than the
limit.
"""
SINGULAR = 0.08
"""Below this smallest singular value of the tip's Jacobian the robot is slowed and the inverse damped."""
_WATCHED = 0.3
"""Below this smallest singular value, its derivative by the joints is computed."""
_DAMPING = 0.04
"""Largest damping of the inverse (Nakamura and Hanafusa, 1986)."""
_JOINTS_COUNT = 1e-3
"""Weight of joint speeds beside the tip's: small, and only to make the metric invertible."""
_SLOWEST = 0.1
"""Share of the speed left in a singularity, so that the robot gets out again."""


@dataclass(frozen=True)
class PoseTarget:
    """Bring the tip to `pose` (4, 4), which itself moves with the twist `velocity` (6,): m/s, rad/s, both in the base
    frame. Within the `tolerance` it is there. The tip is that of the `group`, whose joints alone move.
    """

    pose: Array
    velocity: Array = field(default_factory=lambda: np.zeros(6))
    tolerance: PoseTolerance | None = None
    group: str | None = None

    def moving(self, before: Array, passed: float) -> Self:
        """The same target, which was at `before` (4, 4) `passed` s ago, and continues at this twist."""
        turn = rotation_vector(self.pose[:3, :3] @ before[:3, :3].T)
        return replace(self, velocity=np.concatenate((self.pose[:3, 3] - before[:3, 3], turn)) / passed)

    def error(self, tip: Array, pose: Array) -> Array:
        """What a tip (4, 4) is off the target (6,), which is at `pose` (4, 4): m and rad in the base frame, without what
        the tolerance allows.
        """
        error = np.concatenate((pose[:3, 3] - tip[:3, 3], rotation_vector(pose[:3, :3] @ tip[:3, :3].T)))
        if self.tolerance is None:
            return error
        bounds = np.array(self.tolerance.bounds)
        shift, turn = self._axes(pose)
        off, turned = shift.T @ error[:3], turn.T @ error[3:]
        if self.tolerance.radius is None:
            off -= np.clip(off, -bounds[3:6], bounds[3:6])
        else:
            off *= max(0.0, 1.0 - self.tolerance.radius / max(float(np.linalg.norm(off)), 1e-12))
        turned -= np.clip(turned, -bounds[:3], bounds[:3])
        return np.concatenate((shift @ off, turn @ turned))

    def held(self, pose: Array) -> Array:
        """The directions (k, 6) of a twist in the base frame that are not free, with the target at `pose` (4, 4)."""
        if self.tolerance is None:
            return np.eye(6)
        bounds = np.array(self.tolerance.bounds)
        shift, turn = self._axes(pose)
        rows = np.zeros((6, 6))
        rows[:3, :3], rows[3:, 3:] = shift.T, turn.T
        counts = np.concatenate((np.isfinite(bounds[3:6]) | np.isfinite(bounds[6]), np.isfinite(bounds[:3])))
        return np.asarray(rows[counts])

    def _axes(self, pose: Array) -> tuple[Array, Array]:
        """The axes (3, 3) of the components of position and of orientation."""
        turn = pose[:3, :3]
        return (turn if self.tolerance is not None and self.tolerance.frame == "tool" else np.eye(3)), turn

    def after(self, passed: float) -> Array:
        """Its expected pose (4, 4) `passed` s later."""
        return moved(self.pose, self.velocity, passed)


@dataclass(frozen=True)
class TwistTarget:
    """Move the tip, of the `group`, with `twist` (6,): m/s, then rad/s, along the axes of the base or of the tool (the tip)."""

    twist: Array
    frame: Literal["base", "tool"] = "base"
    group: str | None = None

    def in_base(self, tip: Array) -> Array:
        """The twist (6,) along the axes of the base, with the tip at a pose (4, 4)."""
        turn = tip[:3, :3] if self.frame == "tool" else np.eye(3)
        return np.concatenate((turn @ self.twist[:3], turn @ self.twist[3:]))


@dataclass(frozen=True)
class JointSpeedTarget:
    """Move the joints with `velocity` (J,) in rad/s."""

    velocity: Array


@dataclass(frozen=True)
class JointTarget:
    """Bring the joints to `position` (J,) in rad, continuous ones the short way; they move on with `velocity` (J,) in rad/s and
    `acceleration` (J,) in rad/s^2.
    """

    position: Array
    velocity: Array = field(default_factory=lambda: np.zeros(1))
    acceleration: Array = field(default_factory=lambda: np.zeros(1))

    def after(self, passed: float) -> Self:
        """The same target, `passed` s later."""
        velocity = self.velocity + passed * self.acceleration
        return replace(self, position=self.position + passed * (self.velocity + velocity) / 2, velocity=velocity)

    def distance(self, model: RobotModel, position: Array) -> Array:
        """How far (J,) in rad the joints at `position` (J,) have to go."""
        distance = self.position - position
        return distance - whole_turns(distance, model.continuous)


Target = PoseTarget | TwistTarget | JointSpeedTarget | JointTarget


@dataclass(frozen=True)
class Wish:
    """Joint speeds (J,) in rad/s that lead to a target, inside the speed limits; `singular`: a singularity slows them.

    `inverse` (J, J) is that of the quadratic cost of changing these speeds to avoid obstacles. It measures in the space
    of the target, so that the tip loses only the part of its motion that leads into the obstacle. `singularity`: the
    smallest singular value of the tip's Jacobian, and its derivative by each joint (J,); infinite if it is not near 0.
    """

    velocity: Array
    inverse: Array
    singularity: tuple[float, Array]
    singular: bool = False


def wish(model: RobotModel, target: Target, age: float, position: Array, speed: Array, acceleration: Array) -> Wish:
    """The joint speeds towards a target `age` s old at `position` (J,), with limits (J,) in rad/s and rad/s^2."""
    if isinstance(target, JointSpeedTarget):
        return Wish(within_speed(target.velocity, speed), np.eye(model.dof), (math.inf, np.zeros(model.dof)))
    if isinstance(target, JointTarget):
        now = target.after(age)
        velocity = within_speed(approach(now.distance(model, position), acceleration) + now.velocity, speed)
        return Wish(velocity, np.eye(model.dof), (math.inf, np.zeros(model.dof)))
    held = target.held(target.after(age)) if isinstance(target, PoseTarget) else np.eye(6)
    whole = model.tip_jacobian(position, target.group)
    u, values, v = np.linalg.svd(held @ whole, full_matrices=False)
    least = float(values[-1])
    near = min(1.0, least / SINGULAR)
    inverse = (v.T * (values / (values**2 + _DAMPING**2 * (1.0 - near**2)))) @ u.T
    if isinstance(target, TwistTarget):
        velocity = inverse @ target.in_base(model.fk_tip(position, target.group))
    else:
        error = held @ target.error(model.fk_tip(position, target.group), target.after(age))
        velocity = approach(inverse @ error, acceleration) + inverse @ (held @ target.velocity)
    return Wish(
        max(near, _SLOWEST) * within_speed(velocity, speed),
        _inverse_metric(values, v),
        (least, _change(whole, held.T @ u[:, -1], v[-1])) if least < _WATCHED else (math.inf, np.zeros(model.dof)),
        near < 1.0,
    )


def approach(distance: Array, acceleration: Array) -> Array:
    """Joint speeds (J,) that close a distance (J,) along a straight line and brake in time."""
    with np.errstate(divide="ignore"):
        rate = np.sqrt(2 * _BRAKING * acceleration / np.abs(distance)).min()
    return np.asarray(min(rate, GAIN) * distance)


def within_speed(velocity: Array, speed: Array) -> Array:
    """Joint speeds (J,), scaled down uniformly if any joint exceeds `speed` (J,)."""
    return np.asarray(velocity / max(1.0, float((np.abs(velocity) / speed).max())))


def _inverse_metric(values: Array, v: Array) -> Array:
    """The inverse (J, J) of the square of a Jacobian, with these singular values and right singular vectors, plus
    _JOINTS_COUNT times the identity.
    """
    shares = values**2 / (values**2 + _JOINTS_COUNT)
    return np.asarray((np.eye(v.shape[1]) - (v.T * shares) @ v) / _JOINTS_COUNT)


def _change(jacobian: Array, u: Array, v: Array) -> Array:
    """The derivative by each joint (J,) of the singular value of a Jacobian (6, J) with singular vectors `u` (6,) and
    `v` (J,).

    (Bruyninckx and De Schutter, "Symbolic differentiation of the velocity mapping for a serial kinematic chain", 1996.)
    """
    linear, angular = jacobian[:3].T, jacobian[3:].T
    shifted = np.triu(-angular @ _cross(u[:3]) @ linear.T)  # (a x b) u for each pair, here as -a (u x b)
    turned = np.tril(angular @ _cross(u[3:]) @ angular.T, -1)
    return np.asarray(v @ (shifted + np.triu(shifted, 1).T + turned))


def _cross(vector: Array) -> Array:
    """The matrix (3, 3) whose product with any b is the cross product of `vector` (3,) with b."""
    x, y, z = vector
    return np.array(((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)))


def moved(pose: Array, twist: Array, passed: float) -> Array:
    """A pose (4, 4) after `passed` s with a twist (6,), m/s and rad/s in the base frame."""
    after = pose.copy()
    after[:3, 3] += passed * twist[:3]
    angle = passed * math.sqrt(float(twist[3:] @ twist[3:]))
    if angle > 0.0:
        cross = _cross(twist[3:] * (passed / angle))  # Rodrigues' formula
        after[:3, :3] = (np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross) @ pose[:3, :3]
    return after


def rotation_vector(turn: Array) -> Array:
    """The axis times the angle (3,) of a rotation matrix (3, 3)."""
    twice_sine = np.array((turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]))
    length = float(np.linalg.norm(twice_sine))
    angle = math.atan2(length, float(np.trace(turn)) - 1.0)
    if length > 1e-6:
        return np.asarray(twice_sine * (angle / length))
    if angle < 1.0:
        return twice_sine / 2
    # Half a turn: the axis is the largest column of (R + 1) / 2.
    columns = (turn + np.eye(3)) / 2
    column = columns[:, int(np.argmax(np.diag(columns)))]
    return np.asarray(column / np.linalg.norm(column) * angle)
