"""A step of the local controller: joint speeds inside all bounds, and a motion to rest that begins with them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from zarm_geometry.kernels.compiled import brief, inlined, kernel
from zarm_geometry.kernels.situation import GRADIENT_THERE, KEPT_MARGIN, SituationArrays, contact
from zarm_servo.kernels.projection import FLAT, projected
from zarm_servo.kernels.speed_change import phases, sampled
from zarm_trajectory.arrays import Array

PERIOD = 0.004
"""Seconds from one step to the next."""
RANGE = 0.15
"""Obstacles further away than this (m) do not slow the robot."""
FREE, JOINT_LIMIT, SINGULARITY, SLOWING, BLOCKED = range(5)
"""What limits a step."""
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
SHARES = (1.0, 0.5, 0.2)
"""Shares of the wanted step to try; the first that is free is taken."""
_LEAVING = 0.03
"""Speed (m/s) away from anything the robot is already too close to."""
_CREEPING = 0.1
"""Largest joint speed (rad/s) while doing so: no part moves more than 1 or 2 mm between two samples of a braking
motion.
"""
_CROSSING = 0.02
"""The smallest singular value may always fall at this rate (1/s): the robot crosses a singularity slowly."""
_ROUNDING = 1e-9
"""A joint that has moved less than this (rad) has stayed."""


class JointLimits(NamedTuple):
    """Limits of joints, each (J,), as in `zarm_trajectory.limits`."""

    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array
    jerk: Array


class Braking(NamedTuple):
    """A step and the braking after it: the state (3, J) one period later, the `phases` of the braking from there, and
    positions (N, J) at `times` (N,) from before the step to rest; `inside` tells whether all are within the joints'
    position limits, or no further beyond them than at the beginning.
    """

    after: Array
    begins: Array
    states: Array
    jerks: Array
    times: Array
    positions: Array
    inside: bool


@inlined
def _towards(left: float, acceleration: float) -> float:
    """The highest speed towards something `left` away that still allows braking in time; 0 if nothing is left."""
    left = max(left, 0.0)
    return min(_NEARING * left, math.sqrt(2 * _BRAKING * acceleration * left))


@brief
def bounded(
    position: Array,
    wanted: Array,
    inverse: Array,
    singularity: tuple[float, Array],
    limiting: int,
    near: Array,
    limits: JointLimits,
    margin: float,
    leaving: bool,
    moving: bool,
) -> tuple[Array, bool, int, int]:
    """The joint speeds nearest to those `wanted` (J,) that still slow down in time before limits and obstacles: the
    robot slides along walls. (Faverjon and Tournassoud, "A local based approach for path planning of manipulators",
    1987; projected by Hildreth's method, 1957.)

    `inverse` and `singularity` as in `targets.Wish`; `near` (n, 4 + J) as `situation.nearby` returns it. `leaving`: the
    robot was too close to something and is moving away. Returns the speeds; whether it is leaving now, which is never so
    while anything is `moving`; what limits the speeds, `limiting` if nothing more does; and the row of `near` if that
    is SLOWING.
    """
    joints, pairs = position.shape[0], near.shape[0]
    low, high, inside = np.empty(joints), np.empty(joints), np.empty(joints)
    for j in range(joints):
        low[j] = -_towards(position[j] - limits.lower[j], limits.acceleration[j])
        high[j] = _towards(limits.upper[j] - position[j], limits.acceleration[j])
        inside[j] = min(max(wanted[j], low[j]), high[j])
        if abs(inside[j] - wanted[j]) > 1e-6:
            limiting = JOINT_LIMIT
    left, closest = np.empty(pairs), 0
    for i in range(pairs):
        left[i] = near[i, 0] - min(margin, near[i, KEPT_MARGIN])
        if left[i] < left[closest]:
            closest = i
    # Move away slowly from what is too close. This check ignores time, so it is not used while anything moves.
    enough = _KEPT / 2 if leaving else 0.0
    leaving = pairs > 0 and left[closest] < enough and not moving
    gradients, least, bounds = np.empty((pairs + 1, joints)), np.empty(pairs + 1), 0
    nearest, excess, met = 0, math.inf, True
    for i in range(pairs):
        steep, reach, rate = 0.0, 0.0, 0.0
        for j in range(joints):
            slope = near[i, GRADIENT_THERE + j]
            steep += slope * slope
            reach += abs(slope) * limits.acceleration[j]
            rate += slope * inside[j]
        spare = left[i] - _KEPT
        slowest = min(_LEAVING, -_NEARING * spare) if leaving and spare < 0.0 else -_towards(spare, reach)
        if steep <= FLAT or (rate >= slowest and slowest <= -RANGE):
            continue
        gradients[bounds], least[bounds] = near[i, GRADIENT_THERE:], slowest
        bounds += 1
        met = met and rate >= slowest
        if rate - slowest < excess:
            nearest, excess = i, rate - slowest
    value, change = singularity
    slowed = bounds > 0
    if value < math.inf:
        reach, rate = 0.0, 0.0
        for j in range(joints):
            reach += abs(change[j]) * limits.acceleration[j]
            rate += change[j] * inside[j]
        slowest = -max(_CROSSING, _towards(value, reach))
        if rate < slowest:
            limiting, met = SINGULARITY, False
        gradients[bounds], least[bounds] = change, slowest
        bounds += 1
    speeds = inside.copy() if met else projected(inside, inverse, gradients[:bounds], least[:bounds])
    over = 1.0
    for j in range(joints):
        speeds[j] = min(max(speeds[j], low[j]), high[j])
        fastest = min(limits.velocity[j], _CREEPING) if leaving else limits.velocity[j]
        over = max(over, abs(speeds[j]) / fastest)
    lost = 0.0
    for j in range(joints):
        speeds[j] /= over
        lost = max(lost, abs(speeds[j] - inside[j]))
    if slowed and lost > 1e-3:
        if leaving:
            return speeds, leaving, SLOWING, closest
        if limiting != SINGULARITY or excess < 0.0:
            return speeds, leaving, SLOWING, nearest
    return speeds, leaving, limiting, 0


@brief
def braked(state: Array, wanted: Array, limits: JointLimits) -> Braking:
    """One period from a `state` (3, J) towards the velocities `wanted` (J,), and the braking from there."""
    begins, states, jerks = phases(wanted, state, limits.acceleration, limits.jerk)
    return braked_after(state, sampled(begins, states, jerks, np.full(1, PERIOD))[:, 0].copy(), limits)


@brief
def braked_after(state: Array, after: Array, limits: JointLimits) -> Braking:
    """One period from a `state` (3, J) to the one `after` it (3, J), and the braking from there."""
    joints = state.shape[1]
    begins, states, jerks = phases(np.zeros(joints), after, limits.acceleration, limits.jerk)
    duration = begins[3].max()
    interval = min(max(duration / _SAMPLES, PERIOD), _SAMPLE)
    count = math.ceil(duration / interval)
    when = np.empty(count + 1)
    for k in range(count):
        when[k] = k * interval
    when[count] = duration + 1e-6
    times, positions = np.zeros(count + 2), np.empty((count + 2, joints))
    times[1:] = PERIOD + when
    positions[0], positions[1:] = state[0], sampled(begins, states, jerks, when)[0]
    inside = True
    for j in range(joints):
        # One that is beyond its limit, if only by rounding, may stay and come back, but does not go on.
        least = limits.lower[j] if state[0, j] >= limits.lower[j] else state[0, j] - _ROUNDING
        most = limits.upper[j] if state[0, j] <= limits.upper[j] else state[0, j] + _ROUNDING
        for k in range(count + 2):
            inside = inside and least <= positions[k, j] <= most
    return Braking(after, begins, states, jerks, times, positions, inside)


@kernel
def free_after(
    situation: SituationArrays, state: Array, after: Array, limits: JointLimits, margin: float
) -> tuple[Braking, int, int, int]:
    """One period from a `state` (3, J) to the one `after` it (3, J) and the braking from there; why that is not free
    (FREE if it is), and the part and what it comes too close to if that is BLOCKED.
    """
    motion = braked_after(state, after, limits)
    if not motion.inside:
        return motion, JOINT_LIMIT, 0, 0
    until, part, other = contact(situation, motion.times, motion.positions, limits.acceleration, margin)
    return motion, FREE if until == motion.times.shape[0] - 1 else BLOCKED, part, other


@kernel
def first_free(
    situation: SituationArrays, state: Array, wanted: Array, limits: JointLimits, margin: float
) -> tuple[bool, Braking, int, int, int]:
    """The first of the SHARES of the velocities `wanted` (J,) with which one period and the braking after it are free.

    Returns whether there is one, the motion to rest that was tried last, why the one before it is not free (FREE if it
    was the first), and the part and what it comes too close to if that is BLOCKED.
    """
    limiting, part, other = FREE, 0, 0
    motion = braked(state, wanted, limits)
    for k in range(len(SHARES)):
        if k > 0:
            motion = braked(state, SHARES[k] * wanted, limits)
        if not motion.inside:
            limiting = JOINT_LIMIT
            continue
        until, near_part, near_it = contact(situation, motion.times, motion.positions, limits.acceleration, margin)
        if until == motion.times.shape[0] - 1:
            return True, motion, limiting, part, other
        limiting, part, other = BLOCKED, near_part, near_it
    return False, motion, limiting, part, other
