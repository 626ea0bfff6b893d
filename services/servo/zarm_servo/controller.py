"""The local controller: each period one step towards a live target, with verified braking from its end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from zarm_contract.messages import Attached
from zarm_geometry.motion_check import MotionCheck, MovingObject, NearPair
from zarm_geometry.robot_model import RobotModel
from zarm_servo.targets import Target, Wish, wish, within_speed
from zarm_trajectory.limits import Limits
from zarm_trajectory.quintic import Array
from zarm_trajectory.speed_change import SpeedChange

PERIOD = 0.004
"""Seconds from one step to the next."""
STALE = 0.1
"""A target that is older (s) is none: the robot brakes."""
RANGE = 0.15
"""What is further away (m) slows nothing."""
_NEARING = 4.0
"""Speed towards something per distance that is left, 1/s."""
_BRAKING = 0.3
"""Share of the joints' acceleration that the speed towards something is bounded by."""
_KEPT = 0.0003
"""So much more (m) than the margin is kept where a step ends, for what the check is too careful."""
_SAMPLE = 0.01
"""A braking is checked at times so far apart (s)."""
_ROUNDS = 20
"""Of the projection onto the bounds; what is not exact then is caught by the check."""
_EXACT = 1e-5
"""A projection ends once no bound is missed by more (m/s)."""
_PARTS = (1.0, 0.5, 0.2)
"""Of the step that is wanted the first that is free is taken."""
_LEAVING = 0.03
"""Speed (m/s) away from what a robot finds itself too near to."""
_CREEPING = 0.1
"""Largest joint speed (rad/s) there: between two samples of a braking no part moves by more than a millimetre or two."""
_CROSSING = 0.02
"""The smallest singular value may fall so fast (1/s) all the way: a singularity is crossed slowly."""
_STEADY = 1e-6
"""A distance that falls by less (m) from one sample to the next does not fall."""

Limiting = Literal["free", "slowing", "blocked", "singularity", "joint_limit", "target_stale"]


@dataclass(frozen=True)
class Limitation:
    """What limits a step, and the pair that does so with its distance (m) where it is one: `slowing` or `blocked`."""

    kind: Limiting
    pair: tuple[str, str] | None = None
    distance: float | None = None


@dataclass(frozen=True)
class Surroundings:
    """What else the checks are told: as in `MotionCheck.check`."""

    attached: Sequence[Attached] = ()
    ignored_links: Sequence[str] = ()
    moving: Sequence[MovingObject] = ()


@dataclass(frozen=True)
class Step:
    """Where the robot is to be a period later, `state` (3, J): position, velocity, acceleration.

    From there `braking` leads to rest, `braked` (s) of which have passed there.
    """

    state: Array
    braking: SpeedChange
    braked: float
    limitation: Limitation


class Controller:
    """Steers one robot from rest at `position` (J,), inside `limits`, and `margin` (m) away from all that `check` knows.

    What it commands is always part of a motion to rest that was found free as a whole. In a world that does not change it never
    comes nearer than the margin. Where it finds itself nearer to something, at the start or after an edit, it creeps outwards as
    soon as there is a target: none of the distances below the margin falls, until all of them are above it.
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
        """From its state to rest, where it has just begun or started again."""
        return self._braking

    def restart(self, state: Array) -> None:
        """Go on from another state (3, J), in which the robot is led by something else."""
        self.state = state.copy()
        self.state[2] = np.clip(state[2], -self._limits.acceleration, self._limits.acceleration)
        self._braking, self._braked = self._to_rest(self.state), 0.0

    def step(self, target: Target | None, age: float, around: Surroundings = Surroundings()) -> Step:
        """The next step towards `target`, which was said `age` s ago; None, or one that is STALE: to rest."""
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
            after = change.sample(np.array([PERIOD]))[:, 0]
            braking = self._to_rest(after)
            obstruction = self._obstruction(braking, around)
            if obstruction is None:
                self.state, self._braking, self._braked = after, braking, 0.0
                return Step(after, braking, 0.0, limitation)
            limitation = obstruction
        self._braked += PERIOD
        self.state = self._braking.sample(np.array([self._braked]))[:, 0]
        return Step(self.state, self._braking, self._braked, limitation)

    def _to_rest(self, state: Array) -> SpeedChange:
        return SpeedChange.to(np.zeros(state.shape[1]), state, self._limits.acceleration, self._limits.jerk)

    def _obstruction(self, braking: SpeedChange, around: Surroundings) -> Limitation | None:
        """Why the way to where `braking` begins and the braking are not free, if they are not."""
        times = np.append(np.arange(0.0, braking.duration, _SAMPLE), braking.duration + 1e-6)
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
        """The first pair that is nearer than it is to be and comes nearer still on a way through `positions` (N, J), if any."""
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
        """Of the joint speeds that slow down in time before limits and obstacles, those nearest to what is `asked`: so it slides
        along walls. (Faverjon and Tournassoud, "A local based approach for path planning of manipulators", 1987; projected by Hildreth's
        method, 1957.)
        """
        position, acceleration = self.state[0], self._limits.acceleration
        lowest = -_towards(position - self._limits.lower, acceleration)
        highest = _towards(self._limits.upper - position, acceleration)
        inside = np.clip(asked.velocity, lowest, highest)
        if np.any(np.abs(inside - asked.velocity) > 1e-6):
            limitation = Limitation("joint_limit")
        pairs = self._nearby(position, RANGE, around)
        least_left = min((self._left(pair) for pair in pairs), default=RANGE)
        # What is too near is left slowly, by a check that knows no time; so not while something moves.
        too_near = least_left < (_KEPT / 2 if self._leaving else 0.0)
        self._leaving = too_near and not around.moving
        bounds = [(pair, self._least(pair, acceleration)) for pair in pairs if pair.gradient @ pair.gradient > 1e-9]
        bounds = [(pair, least) for pair, least in bounds if pair.gradient @ inside < least or least > -RANGE]
        speed = np.minimum(self._limits.velocity, _CREEPING) if self._leaving else self._limits.velocity
        rows = [(pair.gradient, least) for pair, least in bounds]
        if asked.singularity is not None:
            value, change = asked.singularity
            slowly = -max(_CROSSING, float(_towards(np.array(value), np.abs(change) @ acceleration)))
            if change @ inside < slowly:
                limitation = Limitation("singularity")
            rows.append((change, slowly))
        slowest = within_speed(np.clip(_projected(inside, asked.metric, rows), lowest, highest), speed)
        if bounds and np.abs(slowest - inside).max() > 1e-3:
            excess, nearest = min(
                ((float(pair.gradient @ inside) - least, pair) for pair, least in bounds), key=lambda held: held[0]
            )
            if self._leaving:
                nearest = min(pairs, key=self._left)
            elif limitation.kind == "singularity" and excess >= 0.0:
                return slowest, limitation
            limitation = Limitation("slowing", (nearest.link, nearest.object), nearest.distance)
        return slowest, limitation

    def _kept(self, pair: NearPair) -> float:
        """What a pair is to keep (m): the margin, or less where two links are always near to one another."""
        return min(self._margin, pair.room)

    def _left(self, pair: NearPair) -> float:
        """By how much (m) a pair may come nearer."""
        return pair.distance - self._kept(pair)

    def _least(self, pair: NearPair, acceleration: Array) -> float:
        """The least speed (m/s) at which the distance of a pair may grow: below 0 it may fall."""
        left = self._left(pair) - _KEPT
        if self._leaving and left < 0.0:
            return min(_LEAVING, -_NEARING * left)
        return -float(_towards(np.array(left), np.abs(pair.gradient) @ acceleration))


def _towards(left: Array, acceleration: Array) -> Array:
    """How fast one may go towards something that is `left` away, and brake in time; below 0 away from it, where it is too near."""
    braking = np.sqrt(2 * _BRAKING * acceleration * np.maximum(left, 0.0))
    return np.where(left > 0.0, np.minimum(_NEARING * left, braking), 0.0)


def _projected(wanted: Array, metric: Array, bounds: Sequence[tuple[Array, float]]) -> Array:
    """The speeds nearest to `wanted` in the metric (J, J) whose product with each gradient (J,) is not below its bound."""
    if all(float(gradient @ wanted) >= least for gradient, least in bounds):
        return wanted
    found, inverse = wanted, np.linalg.inv(metric)
    ways = [(gradient, inverse @ gradient, least) for gradient, least in bounds if gradient @ gradient > 1e-9]
    steep = [float(gradient @ way) for gradient, way, _ in ways]
    force = [0.0] * len(bounds)
    for _ in range(_ROUNDS):
        largest = 0.0
        for i, (gradient, way, least) in enumerate(ways):
            push = max(-force[i], (least - float(gradient @ found)) / steep[i])
            if push != 0.0:
                force[i] += push
                found = found + push * way
                largest = max(largest, abs(push) * steep[i])
        if largest < _EXACT:
            break
    return found
