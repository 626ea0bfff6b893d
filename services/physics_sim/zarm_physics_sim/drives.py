"""The drives of the joints: what they make of a reference, and the presets."""

from __future__ import annotations

from collections import deque
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import NonNegative, Positive
from zarm_contract.section import Section, read_section
from zarm_trajectory.arrays import Array

_DAMPING = 1.0
"""Of the position loop, as a share of critical damping."""
_LARGEST_ERROR = 0.1
"""A reference does not run away further than this (rad, m) from an arm that cannot follow, as one that is held."""


Share = Annotated[float, Field(ge=0.0, le=1.0)]


class DriveSettings(Section):
    """The drives of a robot, the same for each joint. `friction` and `viscous` are shares of the joint's largest torque, which is
    its effort in the URDF where that can hold the arm.
    """

    bandwidth: Positive = 60.0
    """Of the position loop (rad/s)."""
    integral: NonNegative = 2.0
    """How fast a remaining error is removed (1/s)."""
    feedforward: Share = 1.0
    """Share of the torque of gravity and acceleration that the controller knows beforehand."""
    friction: Share = 0.0
    """Dry friction."""
    viscous: NonNegative = 0.0
    """Friction at 1 rad/s."""
    backlash: NonNegative = 0.0
    """Play between motor, where the encoder is, and joint (rad)."""
    noise: NonNegative = 0.0
    """Standard deviation of the encoder (rad)."""
    delay: Annotated[float, Field(ge=0.0, le=0.2)] = 0.0
    """From a reference to the torque (s)."""
    lag: Positive = 0.01
    """Time constant with which the reference follows the commanded points (s)."""
    plays: Literal["velocity", "position", "either"] = "either"
    """Which part of a point is played; `either`: velocities, and positions of a command that has no velocities."""
    ceiling: Positive = 57_000.0
    """Maximum velocity (deg/s) and acceleration (deg/s²) of every joint."""


PRESETS = {
    "ideal": DriveSettings(bandwidth=100.0),
    "industrial": DriveSettings(feedforward=0.9, friction=0.02, viscous=0.02, noise=1e-5, delay=0.004),
    "hobby": DriveSettings(
        bandwidth=25.0,
        integral=0.0,
        feedforward=0.0,
        friction=0.05,
        viscous=0.05,
        backlash=0.009,
        noise=8e-4,
        delay=0.02,
        lag=0.03,
    ),
    "m1013": DriveSettings(
        feedforward=0.9, friction=0.02, viscous=0.02, noise=1e-5, lag=0.03, plays="velocity", ceiling=70.0
    ),
}
"""Drives by name: none that could be better, those of an industrial arm, servos of a hobbyist's, and the M1013's driver."""


def drive_settings(name_or_file: str) -> DriveSettings:
    """A preset, or the settings in a YAML file. Raises InvalidRequest."""
    if (preset := PRESETS.get(name_or_file)) is not None:
        return preset
    if not Path(name_or_file).is_file():
        raise InvalidRequest(
            f"{name_or_file!r} is neither a file nor one of the presets {', '.join(PRESETS)}", field="--drives"
        )
    return read_section(Path(name_or_file), "settings of drives", DriveSettings)[1]


class Drives:
    """The drives of J joints; `limit` (J,) are their largest torques (Nm, N), infinite if unknown."""

    def __init__(self, settings: DriveSettings, limit: Array, step: float, rng: np.random.Generator) -> None:
        self._settings, self._limit, self._step, self._rng = settings, limit, step, rng
        joints = len(limit)
        self._integral: Array = np.zeros(joints)
        self._motor: Array | None = None
        self._references: deque[tuple[Array, Array, Array]] = deque()
        self._waits = round(settings.delay / step)

    def measured(self, position: Array, velocity: Array) -> tuple[Array, Array]:
        """What the encoders on the motors see of joints at `position` (J,)."""
        settings = self._settings
        if self._motor is None:
            self._motor = position.copy()
        half = 0.5 * settings.backlash
        self._motor = np.minimum(np.maximum(self._motor, position - half), position + half)
        if settings.noise == 0.0:
            return self._motor, velocity
        return self._motor + self._rng.normal(0.0, settings.noise, len(position)), velocity

    def torque(
        self, reference: tuple[Array, Array, Array], measured: tuple[Array, Array], mass: Array, bias: Array
    ) -> Array:
        """The torques (J,) towards a reference of position, velocity and acceleration, each (J,), with the mass matrix
        (J, J) and the torques `bias` (J,) of gravity and speed.
        """
        settings = self._settings
        self._references.append(reference)
        if len(self._references) > self._waits + 1:
            self._references.popleft()
        position, velocity, acceleration = self._references[0]
        error = np.minimum(np.maximum(position - measured[0], -_LARGEST_ERROR), _LARGEST_ERROR)
        w = settings.bandwidth
        closing = w * w * error + 2.0 * _DAMPING * w * (velocity - measured[1])
        wanted = settings.feedforward * (mass @ acceleration + bias) + mass.diagonal() * (closing + self._integral)
        torque = np.minimum(np.maximum(wanted, -self._limit), self._limit)
        if settings.integral > 0.0:
            self._integral = self._integral + (torque == wanted) * (settings.integral * w * w * self._step) * error
        return torque
