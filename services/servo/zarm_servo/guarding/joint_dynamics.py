"""The dynamics of the joints: friction, damping, and the reflected inertia of their motors."""

from __future__ import annotations

from typing import NamedTuple, Self

import numpy as np

from zarm_contract.errors import Unavailable
from zarm_contract.messages import JointDynamics as JointDynamicsMessage
from zarm_geometry.dynamics import JointDynamics
from zarm_trajectory.arrays import Array, Single

_SLIDING_VELOCITY = 0.05
"""Below this velocity (rad/s, m/s) a joint may stick or reverse, so the sign and size of its friction are uncertain."""
STATES_KEPT = 30_000
"""Number of joint states that are fitted: five minutes at 100 Hz."""
MIN_STATES = 1_000
"""Least number of joint states to fit."""


class Moving(NamedTuple):
    """The motion of joints over a few joint states: `direction` (J,) from -1 to 1, `sure` (J,), the share of the friction whose sign is certain, `velocity` (J,) and
    `acceleration` (J,); or many of each, (n, J).
    """

    direction: Array
    sure: Array
    velocity: Array
    acceleration: Array

    @classmethod
    def over(cls, velocities: Array, acceleration: Array) -> Self:
        """Over joint states with these velocities (n, J)."""
        directions: Array = np.tanh(velocities / _SLIDING_VELOCITY)
        return cls(
            directions.mean(axis=0),
            np.abs(directions).min(axis=0),
            0.5 * (velocities[0] + velocities[-1]),
            acceleration,
        )


def unexplained(joints: JointDynamics | None, excess: Array, moving: Moving) -> Array:
    """The part (J,) of `excess` (J,), measured effort less the inverse dynamics of the links, that the joints do not explain: the smallest for any sign of
    the uncertain friction."""
    if joints is None:
        return excess
    rest = excess - joints.torque(moving.direction, moving.velocity, moving.acceleration)
    unsure = joints.friction * (1.0 - moving.sure)
    remaining: Array = rest - np.clip(rest, -unsure, unsure)
    return remaining


class Identification:
    """Fits the joint dynamics to the last `STATES_KEPT` joint states by least squares, none of them negative."""

    def __init__(self, joints: tuple[str, ...]) -> None:
        self._joints = joints
        self._states: Single = np.empty((STATES_KEPT, 5, len(joints)), dtype=np.float32)
        self._count = 0

    def add(self, moving: Moving, excess: Array) -> None:
        """Add a state of a motion; `excess` (J,) is the measured effort less the inverse dynamics of the links."""
        self._states[self._count % STATES_KEPT] = *moving, excess
        self._count += 1

    def found(self) -> JointDynamicsMessage:
        """The joint dynamics fitted to the states so far. Raises Unavailable for too few."""
        states = self._states[: min(self._count, STATES_KEPT)].astype(float)
        if len(states) < MIN_STATES:
            raise Unavailable(
                f"{len(states)} joint states of motions are too few to identify friction, at least {MIN_STATES} are needed; let the robot make the motions of its work"
            )
        moving, excess = Moving(*(states[:, k] for k in range(4))), states[:, 4]
        terms = np.stack((moving.direction, moving.velocity, moving.acceleration), axis=-1)
        fitted = JointDynamics(*np.array([_fitted(terms[:, j], excess[:, j]) for j in range(len(self._joints))]).T)
        largest = np.abs(unexplained(fitted, excess, moving)).max(axis=0)
        friction, damping, armature, rest = (tuple(np.round(each, 3).tolist()) for each in (*fitted, largest))
        return JointDynamicsMessage(
            joint_names=self._joints,
            friction=friction,
            damping=damping,
            armature=armature,
            largest=rest,
            states=len(states),
        )


def _fitted(terms: Array, torque: Array) -> Array:
    """The factors (3,) of the terms (n, 3), none of them negative, that fit a torque (n,) best."""
    kept = np.ones(3, dtype=bool)
    while True:
        factors = np.zeros(3)
        factors[kept] = np.linalg.lstsq(terms[:, kept], torque, rcond=1e-3)[0]
        if factors.min() >= 0.0:
            return factors
        kept[int(factors.argmin())] = False
