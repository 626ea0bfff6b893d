"""The local controller: each period one step towards a live target, with verified braking from its end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from zarm_contract.messages import Attached
from zarm_geometry.motion_check import MotionCheck, MovingObject, NearPair
from zarm_geometry.robot_model import RobotModel
from zarm_servo.kernels.projection import FLAT, projected
from zarm_servo.speed_change import SpeedChange
from zarm_servo.targets import Target, Wish, wish, within_speed
from zarm_trajectory.limits import Limits
from zarm_trajectory.quintic import Array

PERIOD = 0.004
"""Seconds from one step to the next."""
STALE = 0.1
"""A target older than this (s) no longer counts: the robot brakes."""
RANGE = 0.15
"""Obstacles further away than this (m) do not slow the robot."""
_NEARING = 4.0
"""Approach speed per remaining distance, 1/s."""
_BRAKING = 0.3
"""Share of the joint acceleration used to bound the approach speed."""
_KEPT = 0.0003
"""A step keeps this much more (m) than the margin, because the check is conservative."""
_SAMPLES, _SAMPLE = 10, 0.01
"""A braking motion is checked at so many positions or every so many s, whichever is finer, but at most once a period:
a check allows for how far a joint may swing between two positions, so that beside a wall coarse ones block every step.
"""
_PARTS = (1.0, 0.5, 0.2)
"""Shares of the wanted step to try; the first that is free is taken."""
_LEAVING = 0.03
"""Speed (m/s) away from anything the robot is already too close to."""
_CREEPING = 0.1
"""Largest joint speed (rad/s) while doing so: no part moves more than 1 or 2 mm between two samples of a braking
motion.
"""
_CROSSING = 0.02
"""The smallest singular value may always fall at this rate (1/s): the robot crosses a singularity slowly."""
_STEADY = 1e-6
"""A distance that falls by less than this (m) between two samples counts as constant."""

Limiting = Literal["free", "slowing", "blocked", "singularity", "joint_limit", "target_stale"]


@dataclass(frozen=True)
class Limitation:
    """What limits a step; for `slowing` or `blocked` also the pair responsible, with its distance (m)."""

    kind: Limiting
    pair: tuple[str, str] | None = None
    distance: float | None = None


@dataclass(frozen=True)
class Surroundings:
    """Further arguments of the checks, as in `MotionCheck.check`."""

    attached: Sequence[Attached] = ()
    ignored_links: Sequence[str] = ()
    moving: Sequence[MovingObject] = ()


@dataclass(frozen=True)
class Step:
    """The robot's commanded state one period later, `state` (3, J): position, velocity, acceleration.

    `braking` brings it to rest from there; `braked` (s) of it have already passed.
    """

    state: Array
    braking: SpeedChange
    braked: float
    limitation: Limitation


class Controller:
    """Steers one robot from rest at `position` (J,), inside `limits` and `margin` (m) away from everything `check`
    knows.

    Each command is part of a motion to rest that was verified free as a whole. In a static world the robot never comes
    closer than the margin. If it is already too close to something, at the start or after an edit, it creeps away as
    soon as it has a target: until all distances reach the margin, none that is below may fall further.
    """

    def __init__(
        self, model: RobotModel, check: MotionCheck, limits: Limits, position: Array, *, margin: float
    ) -> None:
        self._model, self._check, self._limits, self._margin = model, check, limits, margin
        self.state = np.array((position, np.zeros(model.dof), np.zeros(model.dof)))
        self._braking, self._braked = self._to_rest(self.state), 0.0
        self._leaving = False

    @property
    def braking(self) -> SpeedChange:
        """The braking from the current state to rest; valid right after construction or `restart`."""
        return self._braking

    def restart(self, state: Array) -> None:
        """Continue from another state (3, J), in which something else leads the robot."""
        self.state = state.copy()
        self.state[2] = np.clip(state[2], -self._limits.acceleration, self._limits.acceleration)
        self._braking, self._braked = self._to_rest(self.state), 0.0

    def step(self, target: Target | None, age: float, around: Surroundings = Surroundings()) -> Step:
        """The next step towards `target`, which is `age` s old; with None or a STALE target, towards rest."""
        position = self.state[0]
        speed, acceleration = self._limits.velocity, self._limits.acceleration
        limitation = Limitation("free")
        wanted = np.zeros(self._model.dof)
        if target is None or age > STALE:
            limitation = Limitation("target_stale")
        else:
            asked = wish(self._model, target, age, position, speed, acceleration)
            if asked.singular:
                limitation = Limitation("singularity")
            wanted, limitation = self._bounded(asked, limitation, around)
        for part in _PARTS:
            change = SpeedChange.to(part * wanted, self.state, acceleration, self._limits.jerk)
            after = change.at(PERIOD)
            braking = self._to_rest(after)
            obstruction = self._obstruction(braking, around)
            if obstruction is None:
                self.state, self._braking, self._braked = after, braking, 0.0
                return Step(after, braking, 0.0, limitation)
            limitation = obstruction
        self._braked += PERIOD
        self.state = self._braking.at(self._braked)
        return Step(self.state, self._braking, self._braked, limitation)

    def _to_rest(self, state: Array) -> SpeedChange:
        return SpeedChange.to(np.zeros(state.shape[1]), state, self._limits.acceleration, self._limits.jerk)

    def _obstruction(self, braking: SpeedChange, around: Surroundings) -> Limitation | None:
        """Why the way to the start of `braking`, or the braking itself, is not free; None if it is."""
        interval = np.clip(braking.duration / _SAMPLES, PERIOD, _SAMPLE)
        times = np.append(np.arange(0.0, braking.duration, interval), braking.duration + 1e-6)
        positions = np.vstack((self.state[0], braking.sample(times)[0]))
        if np.any(positions < self._limits.lower) or np.any(positions > self._limits.upper):
            return Limitation("joint_limit")
        if self._leaving:
            return self._approached(positions, around)
        verdict = self._check.check(
            np.append(0.0, PERIOD + times),
            positions,
            margin=self._margin,
            attached=around.attached,
            ignored_links=around.ignored_links,
            moving=around.moving,
            acceleration=self._limits.acceleration,
        )
        if verdict.free or verdict.link is None or verdict.object is None:
            return None
        return Limitation("blocked", (verdict.link, verdict.object), self._margin)

    def _approached(self, positions: Array, around: Surroundings) -> Limitation | None:
        """The first pair that is too close and comes closer still on the way through `positions` (N, J), if any."""
        before: dict[tuple[str, str], float] | None = None
        for position in positions:
            near = self._nearby(position, self._margin, around)
            for pair in near if before is not None else ():
                kept, names = self._kept(pair), (pair.link, pair.object)
                if pair.distance < min((before or {}).get(names, kept), kept) - _STEADY:
                    return Limitation("blocked", names, pair.distance)
            before = {(pair.link, pair.object): pair.distance for pair in near}
        return None

    def _nearby(self, position: Array, within: float, around: Surroundings) -> list[NearPair]:
        return self._check.nearby(
            position,
            within=within,
            attached=around.attached,
            ignored_links=around.ignored_links,
            moving=around.moving,
        )

    def _bounded(self, asked: Wish, limitation: Limitation, around: Surroundings) -> tuple[Array, Limitation]:
        """The joint speeds nearest to those `asked` that still slow down in time before limits and obstacles: the robot
        slides along walls. (Faverjon and Tournassoud, "A local based approach for path planning of manipulators", 1987;
        projected by Hildreth's method, 1957.)
        """
        position, acceleration = self.state[0], self._limits.acceleration
        lowest = -_towards(position - self._limits.lower, acceleration)
        highest = _towards(self._limits.upper - position, acceleration)
        inside = np.clip(asked.velocity, lowest, highest)
        if np.any(np.abs(inside - asked.velocity) > 1e-6):
            limitation = Limitation("joint_limit")
        pairs = self._nearby(position, RANGE, around)
        left = np.array([self._left(pair) for pair in pairs])
        # Move away slowly from what is too close. This check ignores time, so it is not used while anything moves.
        too_near = left.min(initial=RANGE) < (_KEPT / 2 if self._leaving else 0.0)
        self._leaving = too_near and not around.moving
        gradients = np.array([pair.gradient for pair in pairs]).reshape(-1, len(position))
        least = self._least(left - _KEPT, gradients)
        excess = gradients @ inside - least
        bounding = np.flatnonzero(
            (np.square(gradients).sum(axis=1) > FLAT) & ((excess < 0.0) | (least > -RANGE)),
        )
        rows, bounds = gradients[bounding], least[bounding]
        if asked.singularity is not None:
            value, change = asked.singularity
            slowly = -max(_CROSSING, float(_towards(np.array(value), np.abs(change) @ acceleration)))
            if change @ inside < slowly:
                limitation = Limitation("singularity")
            rows, bounds = np.vstack((rows, change)), np.append(bounds, slowly)
        speed = np.minimum(self._limits.velocity, _CREEPING) if self._leaving else self._limits.velocity
        slowest = within_speed(np.clip(_projected(inside, asked.metric, rows, bounds), lowest, highest), speed)
        if bounding.size and np.abs(slowest - inside).max() > 1e-3:
            nearest = bounding[excess[bounding].argmin()]
            if self._leaving:
                nearest = left.argmin()
            elif limitation.kind == "singularity" and excess[nearest] >= 0.0:
                return slowest, limitation
            pair = pairs[nearest]
            limitation = Limitation("slowing", (pair.link, pair.object), pair.distance)
        return slowest, limitation

    def _kept(self, pair: NearPair) -> float:
        """The distance (m) a pair has to keep: the margin, or less for two links that are always close to each other."""
        return min(self._margin, pair.room)

    def _left(self, pair: NearPair) -> float:
        """How much closer (m) a pair may come."""
        return pair.distance - self._kept(pair)

    def _least(self, left: Array, gradients: Array) -> Array:
        """The least rates (N,) in m/s at which distances have to grow of which so much is `left` (N,), in m, and that
        change with the joints by `gradients` (N, J); a distance may fall if its rate is negative.
        """
        least = -_towards(left, np.abs(gradients) @ self._limits.acceleration)
        return np.where(left < 0.0, np.minimum(_LEAVING, -_NEARING * left), least) if self._leaving else least


def _towards(left: Array, acceleration: Array) -> Array:
    """The highest speed towards something `left` away that still allows braking in time; 0 if nothing is left."""
    left = np.maximum(left, 0.0)
    return np.minimum(_NEARING * left, np.sqrt(2 * _BRAKING * acceleration * left))


def _projected(wanted: Array, metric: Array, gradients: Array, least: Array) -> Array:
    """The speeds nearest to `wanted` (J,) in the metric (J, J) whose product with each of the `gradients` (N, J) is at
    least its bound `least` (N,).
    """
    if np.all(gradients @ wanted >= least):
        return wanted
    return projected(wanted, np.asarray(np.linalg.inv(metric), np.float64), gradients, least)
