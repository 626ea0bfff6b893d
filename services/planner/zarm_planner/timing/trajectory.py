"""A trajectory of the joints, and the limits that it has to hold."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from zarm_contract import messages
from zarm_contract.errors import InvalidRequest
from zarm_geometry.robot_model import RobotModel
from zarm_planner.kernels import quintic

Array = NDArray[np.float64]

TOLERANCE = 2e-4
"""By which part a motion may be too fast: then velocity is at most so much over its limit, acceleration twice and jerk three
times as much, all within 0.1 %."""
MAX_SAMPLES = 15_000
"""The longest motion; of 7 joints it is just under the largest message (`zarm_contract.codec.MAX_BYTES`)."""


@dataclass(frozen=True)
class Limits:
    """Per joint, (dof,): rad/s, rad/s^2, rad/s^3."""

    velocity: Array
    acceleration: Array
    jerk: Array

    @classmethod
    def of(cls, model: RobotModel, velocity_scale: float = 1.0, acceleration_scale: float = 1.0) -> Self:
        """The descriptor's limits, scaled."""
        return cls(model.velocity * velocity_scale, model.acceleration * acceleration_scale, model.jerk)


@dataclass(frozen=True)
class Trajectory:
    """Samples of a motion: `time` (n,) in s from 0, the rest (n, dof) in rad, rad/s, rad/s^2.

    Between samples it is the quintic that meets all three at both ends, as `zarm_contract.messages.Trajectory` says.
    """

    time: Array
    position: Array
    velocity: Array
    acceleration: Array

    @classmethod
    def standing(cls, position: Array, dt: float) -> Self:
        """Rest at `position` (dof,) for `dt` s."""
        return cls(np.array([0.0, dt]), np.stack((position, position)), *np.zeros((2, 2, len(position))))

    @property
    def _samples(self) -> quintic.Samples:
        return quintic.Samples(*map(_packed, (self.time, self.position, self.velocity, self.acceleration)))

    @property
    def duration(self) -> float:
        """Seconds from the first to the last sample."""
        return float(self.time[-1])

    @property
    def length(self) -> float:
        """Length of the way in joint space (rad, Euclidean)."""
        return float(np.linalg.norm(np.diff(self.position, axis=0), axis=1).sum())

    def at(self, t: Array) -> tuple[Array, Array, Array]:
        """Position, velocity and acceleration at times `t` (k,) within the motion, each (k, dof)."""
        out = np.empty((3, len(t), self.position.shape[1]))
        quintic.sample(self._samples, _packed(t), out)
        return out[0], out[1], out[2]

    def travel(self, reach: Array) -> Array:
        """How far (n - 1,) a point moves at most from sample to sample, if by at most `reach` (dof,) per rad of each joint.

        In a part of the time between two samples it is no more than that part of it.
        """
        out = np.empty(len(self.time) - 1)
        quintic.travel(self._samples, _packed(reach), out)
        return out

    def load(self, limits: Limits) -> float:
        """How far the limits are used, 1 being fully: slower by this factor, the motion just keeps all of them.

        Velocity and acceleration are taken also between samples, jerk as the mean from sample to sample.
        """
        most = _packed(limits.velocity), _packed(limits.acceleration), _packed(limits.jerk)
        velocity, acceleration, jerk = quintic.load(self._samples, most)
        return float(np.max((velocity, math.sqrt(acceleration), math.cbrt(jerk))))

    def slower(self, factor: float) -> Trajectory:
        """The same motion, taking `factor` times as long."""
        return Trajectory(self.time * factor, self.position, self.velocity / factor, self.acceleration / factor**2)

    def message(self, joint_names: tuple[str, ...]) -> messages.Trajectory:
        """As a message."""
        position, velocity, acceleration = (
            tuple(map(tuple, rows.tolist())) for rows in (self.position, self.velocity, self.acceleration)
        )
        return messages.Trajectory(
            joint_names=joint_names,
            time=tuple(self.time.tolist()),
            position=position,
            velocity=velocity,
            acceleration=acceleration,
        )


def _packed(array: Array) -> Array:
    """In the one layout in memory that kernels are compiled for; for another one they would be compiled anew."""
    return np.ascontiguousarray(array, np.float64)


def sample_times(knots: Array, factor: float, dt: float) -> Array:
    """Times (n,) from the first to the last of the ascending `knots` (k,) in s, these among them; at `factor` times as long
    they are `dt` s apart or less.

    Raises InvalidRequest where these are more than MAX_SAMPLES.
    """
    pieces = np.maximum(1.0, np.ceil(np.diff(knots) * factor / dt - 1e-6))
    if (count := pieces.sum()) > MAX_SAMPLES:
        raise InvalidRequest(
            f"the motion would last {(knots[-1] - knots[0]) * factor:.3g} s, and needs more than the {MAX_SAMPLES} samples "
            "that one message holds; raise velocity_scale and acceleration_scale",
            field="velocity_scale",
        )
    return np.interp(np.arange(int(count) + 1), np.insert(np.cumsum(pieces), 0, 0.0), knots)


def within(sample: Callable[[float], Trajectory], limits: Limits) -> Trajectory:
    """A motion that can be sampled at any factor of its shortest duration, as much slower as the limits demand."""
    factor = 1.0
    for _ in range(8):  # one or two rounds are the rule: sampled elsewhere, the motion has its extremes elsewhere
        trajectory = sample(factor)
        load = trajectory.load(limits)
        if load <= 1 + TOLERANCE:
            return trajectory
        factor *= load
    return trajectory.slower(load)
