"""The local controller: each period one step towards a live target, with verified braking from its end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from zarm_contract.messages import Attached
from zarm_geometry.allowed_collisions import Pairs
from zarm_geometry.kernels.situation import nearby
from zarm_geometry.motion_check import MotionCheck
from zarm_geometry.robot_model import Openings, RobotModel
from zarm_geometry.situation import MovingObject, Situation
from zarm_servo.kernels.step import (
    BLOCKED,
    FREE,
    JOINT_LIMIT,
    PERIOD,
    RANGE,
    SHARES,
    SINGULARITY,
    SLOWING,
    Braking,
    JointLimits,
    bounded,
    braked,
    first_free,
    free_after,
)
from zarm_servo.tracking.jog_line import JogLine
from zarm_servo.tracking.speed_change import SpeedChange
from zarm_servo.tracking.targets import Target, TwistTarget, wish
from zarm_trajectory.arrays import Array
from zarm_trajectory.limits import Limits

STALE = 0.1
"""A target older than this (s) no longer counts: the robot brakes."""
_STEADY = 1e-6
"""A distance that falls by less than this (m) between two samples counts as constant."""

Limiting = Literal["free", "slowing", "blocked", "singularity", "joint_limit", "target_stale"]
_ASIDE: frozenset[Limiting] = frozenset(("slowing", "blocked", "joint_limit", "target_stale"))
"""What leads the tip aside of the line that a jog asks for, or ends it."""
_KINDS: dict[int, Limiting] = {FREE: "free", JOINT_LIMIT: "joint_limit", SINGULARITY: "singularity"}


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
    openings: Openings = ()
    allowed: Pairs = ()


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
        self._model, self._check, self._margin = model, check, margin
        self._limits = JointLimits(limits.lower, limits.upper, limits.velocity, limits.acceleration, limits.jerk)
        self.state = np.array((position, np.zeros(model.dof), np.zeros(model.dof)))
        self._braking, self._braked = self._to_rest(self.state), 0.0
        self._leaving = False
        self._jog_line = JogLine()

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
        situation = self._situation(around)
        if target is None or age > STALE:
            wanted, limitation = np.zeros(self._model.dof), Limitation("target_stale")
        else:
            wanted, limitation = self._bounded(target, age, situation, moving=bool(around.moving))
        motion, obstruction = (self._away if self._leaving else self._onward)(wanted, situation)
        if (obstruction or limitation).kind in _ASIDE:
            self._jog_line.end()
        if motion is None:
            self._braked += PERIOD
            self.state = self._braking.at(self._braked)
        else:
            self.state, self._braked = motion.after, 0.0
            self._braking = SpeedChange(motion.begins, motion.states, motion.jerks)
        return Step(self.state, self._braking, self._braked, obstruction or limitation)

    def follow(self, after: Array, around: Surroundings = Surroundings()) -> Step | None:
        """One step along a given motion inside the joints' limits, to the state `after` this one (3, J); None, and nothing changes, if that
        or the braking from there is not free.
        """
        situation = self._situation(around)
        motion, limiting, _, _ = free_after(situation.arrays, self.state, after, self._limits, self._margin)
        if limiting != FREE:
            return None
        self.state, self._braked, self._leaving = motion.after, 0.0, False
        self._braking = SpeedChange(motion.begins, motion.states, motion.jerks)
        return Step(self.state, self._braking, 0.0, Limitation("free"))

    def _situation(self, around: Surroundings) -> Situation:
        return self._check.situation(
            around.attached, around.ignored_links, around.moving, around.openings, around.allowed
        )

    def _to_rest(self, state: Array) -> SpeedChange:
        return SpeedChange.to(np.zeros(state.shape[1]), state, self._limits.acceleration, self._limits.jerk)

    def _bounded(self, target: Target, age: float, situation: Situation, *, moving: bool) -> tuple[Array, Limitation]:
        """The joint speeds towards a target inside all bounds, see the kernel, and what limits them."""
        position = self.state[0]
        if isinstance(target, TwistTarget):
            target = self._jog_line.follow(self._model, target, self.state, self._limits.acceleration, PERIOD)
        else:
            self._jog_line.end()
        asked = wish(self._model, target, age, position, self._limits.velocity, self._limits.acceleration)
        near = nearby(situation.arrays, position, 0.0, RANGE)
        speeds, self._leaving, limiting, row = bounded(
            position,
            asked.velocity,
            asked.inverse,
            asked.singularity,
            SINGULARITY if asked.singular else FREE,
            near,
            self._limits,
            self._margin,
            self._leaving,
            moving,
        )
        if limiting != SLOWING:
            return speeds, Limitation(_KINDS[limiting])
        distance, part, other = near[row, :3].tolist()
        return speeds, Limitation("slowing", situation.named(int(part), int(other)), distance)

    def _onward(self, wanted: Array, situation: Situation) -> tuple[Braking | None, Limitation | None]:
        """The fastest free motion to rest that begins with a share of the speeds `wanted` (J,), if any, and why it is
        none that begins faster.
        """
        found, motion, limiting, part, other = first_free(
            situation.arrays, self.state, wanted, self._limits, self._margin
        )
        obstruction = None
        if limiting == BLOCKED:
            obstruction = Limitation("blocked", situation.named(part, other), self._margin)
        elif limiting != FREE:
            obstruction = Limitation(_KINDS[limiting])
        return motion if found else None, obstruction

    def _away(self, wanted: Array, situation: Situation) -> tuple[Braking | None, Limitation | None]:
        """The same from a place that is too close to something, away from it."""
        obstruction = None
        for share in SHARES:
            motion = braked(self.state, share * wanted, self._limits)
            refused = self._approached(motion.positions, situation) if motion.inside else Limitation("joint_limit")
            if refused is None:
                return motion, obstruction
            obstruction = refused
        return None, obstruction

    def _approached(self, positions: Array, situation: Situation) -> Limitation | None:
        """The first pair that is too close and comes closer still on the way through `positions` (N, J), if any."""
        before: dict[tuple[str, str], float] | None = None
        for position in positions:
            near = situation.nearby(position, within=self._margin)
            for pair in near if before is not None else ():
                kept, names = min(self._margin, pair.kept_margin), (pair.link, pair.object)
                if pair.distance < min((before or {}).get(names, kept), kept) - _STEADY:
                    return Limitation("blocked", names, pair.distance)
            before = {(pair.link, pair.object): pair.distance for pair in near}
        return None
