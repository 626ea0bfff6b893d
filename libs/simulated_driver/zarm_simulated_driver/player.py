"""How the simulated arm plays commands: one point per tick, by index, through a drive with lag and limits.

The model of one axis: the velocity follows the point's with a first-order lag, dv/dt = (target - v) / lag,
bounded by the controller's limits of acceleration and velocity. The model knows no bus and no clock.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from zarm_contract.errors import InvalidRequest
from zarm_contract.messages import Vector3
from zarm_trajectory.arrays import Array

TICK = 0.02
"""One point is played for this long, s: the timer of the Doosan bridge."""
STEP = 0.01
"""Time step of the drives, s, and period of the joint states: two steps per point."""
LAG = 0.03
"""Time constant of the M1013's drives, s."""
CEILING = math.radians(70.0)
"""The real-time ceilings of the M1013's driver for each joint: 70 deg/s and 70 deg/s^2, in rad/s and rad/s^2. An arm that
stops by itself brakes no harder than the second."""
STIFFNESS = 8.0
"""How fast a drive that plays positions closes a position error, 1/s."""

Kind = Literal["velocity", "position", "either"]


class Player:
    """An arm of J joints at `position` (J,) rad with `velocity` (J,) rad/s.

    It plays velocities and ignores positions and times, as the Doosan bridge does, or, with `plays="position"`,
    positions as a position-controlled arm; with `plays="either"` positions if a command has no velocities at all, as
    those of the strategy `joint_pose`. When the points run out it brakes to rest. No joint ever exceeds `ceiling`
    rad/s, nor changes its velocity faster than `ceiling` rad/s^2: with a high one it follows any command. `feed` (J,)
    is the present commanded velocity, rad/s.
    """

    def __init__(
        self, position: Array, *, plays: Kind = "velocity", ceiling: float = CEILING, lag: float = LAG
    ) -> None:
        self.position = position.copy()
        self.velocity: Array = np.zeros_like(position)
        self.total = 0
        self.played = 0
        self._plays = plays
        self._by_position = plays == "position"
        self._ceiling, self._share = ceiling, 1.0 - math.exp(-STEP / lag)
        self._positions: Array = np.zeros((0, len(position)))
        self._velocities: Array = np.zeros((0, len(position)))
        self._target = position.copy()
        self.feed: Array = np.zeros_like(position)
        self._steps = 0
        self._stopping = True

    @property
    def effort(self) -> None:
        """No torque moves what has no mass."""
        return None

    @property
    def fraction(self) -> float:
        """The played share of the last command; 1 if it was empty."""
        return self.played / self.total if self.total else 1.0

    def play(self, positions: Array, velocities: Array) -> int:
        """Play these points (N, J) from the next tick on instead of the remaining ones; none: stop.

        A row of NaN, for a point without the values that the arm plays, repeats the previous one; returns the number of
        such rows. Without velocities, (0, J), every point lacks them.
        """
        self.total, self.played = len(positions), 0
        if self._plays == "either" and self.total:
            self._by_position = not np.isfinite(velocities).all(axis=-1).any()
        self._positions = _filled(positions, self._target)
        if not self._by_position:
            played = velocities if len(velocities) else np.full_like(positions, np.nan)
            self._velocities = _filled(played, self.feed)
        else:
            played = positions
            self._velocities = np.diff(self._positions, axis=0, append=self._positions[-1:]) / TICK
        return int(np.isnan(played).any(axis=1).sum())

    def step(self, *, stalled: bool = False) -> None:
        """Let `STEP` seconds pass. A stalled player plays no further point and brakes to rest."""
        if self._steps % round(TICK / STEP) == 0:
            self._next_point(stalled)
        self._steps += 1
        wanted = self.feed
        if self._by_position:
            if self.total == 0 and self.velocity.any():
                self._target = self.position  # told to stop: it holds its rest position
            wanted = wanted + STIFFNESS * (self._target - self.position)
        wanted = np.clip(wanted, -self._ceiling, self._ceiling)
        change = (wanted - self.velocity) * self._share
        most = STEP * (min(self._ceiling, CEILING) if self._stopping else self._ceiling)
        before = self.velocity
        self.velocity = before + np.clip(change, -most, most)
        self.velocity[np.abs(self.velocity) < 1e-6] = 0.0
        self.position = self.position + 0.5 * (before + self.velocity) * STEP

    def displace(self, offset: Array) -> None:
        """Be elsewhere at once, by `offset` (J,) rad."""
        self.position = self.position + offset

    def push(self, force: Vector3 | None) -> None:
        """Raises InvalidRequest for a force: without mass there is nothing to push."""
        if force is not None:
            raise InvalidRequest("this driver has no mass; start one with physics (--driver physics)", field="push")

    def _next_point(self, stalled: bool) -> None:
        if stalled:
            self._target = self.position
        self._stopping = stalled or self.played >= self.total
        if self._stopping:
            self.feed = np.zeros_like(self.position)
            return
        self.feed = self._velocities[self.played]
        self._target = self._positions[self.played]
        self.played += 1


def _filled(rows: Array, before: Array) -> Array:
    """`rows` (N, J), each with a non-finite value replaced by the row above it, the first by `before` (J,)."""
    filled = rows.copy()
    for row in filled:
        if not np.isfinite(row).all():
            row[:] = before
        before = row
    return filled
