"""The line that a jog keeps to: straight on from where its direction was asked for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from zarm_geometry.robot_model import RobotModel
from zarm_servo.tracking.targets import GAIN, TwistTarget, moved, rotation_vector
from zarm_trajectory.arrays import Array

_PARALLEL = 0.9999
"""Cosine of two twists with one direction: within 0.8 deg."""
_ASIDE = 0.1
"""Share of its twist by which the tip may still move otherwise where the line begins."""
_ACCELERATION_SHARE = 0.8
"""Share of the joints' acceleration with which the tip changes its speed on the line; the rest is to keep it there."""
_LOST = 0.01
"""m and rad off the line from which another one begins: a singularity has led the tip aside, and nobody expects it to come back."""
_SLOWLY = 0.02
"""m/s and rad/s at which the tip may come back to its line, if it does not move faster along it."""
_DAMPING = 0.04
"""Damping of the inverse Jacobian, as near singularities."""


class JogLine:
    """Lets the tip start, move and stop on a line. Each joint on its own, as fast as it can, would lead it aside by centimetres.

    A twist in another direction begins another line, once the tip no longer moves in the old one. Backwards is the same line, and so is a
    stop.
    """

    def __init__(self) -> None:
        self._direction: TwistTarget | None = None
        self._pose = np.eye(4)
        self._settled = False
        self._speed = 0.0

    def end(self) -> None:
        """Begin another line with the next twist."""
        self._direction = None

    def follow(
        self, model: RobotModel, target: TwistTarget, state: Array, acceleration: Array, dt: float
    ) -> TwistTarget:
        """The twist along the base's axes that leads on and back to the line, `dt` s after the last one, from a `state` (3, J) of joints that
        change their velocity by at most `acceleration` (J,) in rad/s^2.
        """
        if self._direction is None or not _parallel(self._direction, target):
            self._direction = target if np.any(target.twist) else None
            self._settled = False
            return target
        tip = model.fk_tip(state[0], target.group)
        jacobian = model.tip_jacobian(state[0], target.group)
        velocity = jacobian @ state[1]
        if not self._settled:
            self._pose = tip.copy()
        along = self._direction.in_base(self._pose)
        along /= np.linalg.norm(along)
        wanted = float(along @ target.in_base(self._pose))
        if not self._settled:
            self._speed = float(along @ velocity)
            self._settled = bool(np.linalg.norm(velocity - self._speed * along) <= _ASIDE * abs(wanted))
        if not self._settled:
            return target
        if self._speed != wanted:
            rates = jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + _DAMPING**2 * np.eye(6), along)
            change = dt * _ACCELERATION_SHARE * float((acceleration / np.maximum(np.abs(rates), 1e-9)).min())
            self._speed = min(max(wanted, self._speed - change), self._speed + change)
        self._pose = moved(self._pose, float(along @ velocity) * along, dt)
        off = np.concatenate((self._pose[:3, 3] - tip[:3, 3], rotation_vector(self._pose[:3, :3] @ tip[:3, :3].T)))
        off -= along * (along @ off)
        if (distance := float(np.linalg.norm(off))) > _LOST:
            self._pose, off = tip.copy(), np.zeros(6)
        back = min(GAIN, max(abs(self._speed), _SLOWLY) / max(distance, 1e-12)) * off
        return replace(target, twist=self._speed * along + back, frame="base")


def _parallel(direction: TwistTarget, target: TwistTarget) -> bool:
    if (direction.frame, direction.group) != (target.frame, target.group):
        return False
    sizes = float(np.linalg.norm(direction.twist) * np.linalg.norm(target.twist))
    return abs(float(direction.twist @ target.twist)) >= _PARALLEL * sizes
