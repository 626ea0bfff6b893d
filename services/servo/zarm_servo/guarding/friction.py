"""The friction of the joints: what it needs, and what it is."""

from __future__ import annotations

from typing import NamedTuple, Self

import numpy as np

from zarm_contract.descriptor import RobotDescriptor
from zarm_contract.errors import Unavailable
from zarm_contract.messages import FrictionEstimate
from zarm_trajectory.arrays import Array, Single

_SLOW = 0.01
"""Of a joint slower than this (rad/s, m/s) the direction is not sure, and its dry friction counts in part."""
KEPT = 30_000
"""Joint states from which friction is identified: five minutes at 100 Hz."""
LEAST = 1_000
"""From fewer it is not identified."""


def direction_of(velocity: Array) -> Array:
    """The direction (J,) in which joints move, from -1 to 1, and 0 at rest: a smooth sign."""
    return np.tanh(velocity / _SLOW)


class Friction(NamedTuple):
    """Dry (J,) and viscous (J,) friction, in Nm and Nm s/rad; N and N s/m if prismatic."""

    dry: Array
    viscous: Array

    @classmethod
    def of(cls, descriptor: RobotDescriptor) -> Self:
        """What a descriptor states, else none."""
        stated, none = descriptor.execution.friction, np.zeros(len(descriptor.joints))
        return cls(none, none) if stated is None else cls(np.array(stated.dry), np.array(stated.viscous))

    def torque(self, direction: Array, velocity: Array) -> Array:
        """What moves joints in a direction (J,), from -1 to 1, against it at a velocity (J,); or many of both, (n, J)."""
        moving: Array = self.dry * direction + self.viscous * velocity
        return moving


class FrictionIdentification:
    """Finds the friction that explains best, by least squares, what the efforts exceed the model by. It keeps the last `KEPT` states."""

    def __init__(self, joints: tuple[str, ...]) -> None:
        self._joints = joints
        self._states: Single = np.empty((KEPT, 3, len(joints)), dtype=np.float32)
        self._count = 0

    def add(self, direction: Array, velocity: Array, unexplained: Array) -> None:
        """Take a state of a motion: for each joint, its direction from -1 to 1, its velocity, and by how much its effort exceeds the model."""
        self._states[self._count % KEPT] = direction, velocity, unexplained
        self._count += 1

    def estimate(self) -> FrictionEstimate:
        """The friction in the states so far. Raises Unavailable for too few."""
        states = self._states[: min(self._count, KEPT)].astype(float)
        if len(states) < LEAST:
            raise Unavailable(
                f"{len(states)} joint states of motions are too few to identify friction, it takes {LEAST}; let the robot make the motions of its work"
            )
        direction, velocity, unexplained = states[:, 0], states[:, 1], states[:, 2]
        found = Friction(
            *np.array([_fitted(direction[:, j], velocity[:, j], unexplained[:, j]) for j in range(len(self._joints))]).T
        )
        largest = np.abs(unexplained - found.torque(direction, velocity)).max(axis=0)
        dry, viscous, rest = (tuple(np.round(each, 3).tolist()) for each in (*found, largest))
        return FrictionEstimate(joint_names=self._joints, dry=dry, viscous=viscous, largest=rest, states=len(states))


def _fitted(direction: Array, velocity: Array, torque: Array) -> tuple[float, float]:
    """Dry and viscous friction of one joint, neither of them negative."""
    dry, viscous = np.linalg.lstsq(np.column_stack((direction, velocity)), torque, rcond=1e-3)[0]
    if dry < 0.0 or viscous < 0.0:
        alone = velocity if dry < 0.0 else direction
        value = max(0.0, float(alone @ torque) / max(float(alone @ alone), 1e-9))
        return (0.0, value) if dry < 0.0 else (value, 0.0)
    return float(dry), float(viscous)
