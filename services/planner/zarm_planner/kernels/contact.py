"""Moves out of contact, along the gradients of the distances to nearby objects by the joints.

Distances and gradients come from `zarm_geometry.kernels.nearby`. Each step is the smallest that changes every distance
as required; it is found by projecting onto one of these constraints after the other (Kaczmarz' method; Agmon, "The
relaxation method for linear inequalities", 1954). Constraints that contradict each other, like those of the two sides
of a slot, lead to the middle.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.kernels.arrays import Memory, RobotArrays, WorldArrays, space
from zarm_geometry.kernels.clearance_search import Obstacles
from zarm_geometry.kernels.compiled import inlined, kernel
from zarm_geometry.kernels.edge import edge_free
from zarm_geometry.kernels.motion import Motion, MotionBody, Movers, Solids
from zarm_geometry.kernels.nearby import GRADIENT, near
from zarm_geometry.kernels.vectors import copy
from zarm_planner.kernels.clock import passed
from zarm_planner.kernels.inverse import TOLERANCE, Chain, Work, descend, make_work, tip_jacobian, tip_pose
from zarm_trajectory.arrays import Array, Bits

WITHIN = 0.05
"""Only objects nearer than this (m) are taken into account."""
SWEEPS = 20
"""Number of passes over all constraints."""
RELAXED = 0.5
"""Fraction of the full correction that a projection applies."""
STEPS = 60
"""Maximum number of steps of `clear_pose`."""
TURN = 0.1
"""Longest step (rad, Euclidean) of `clear_pose`."""
SHORTEST = 0.002
"""`clear_pose` ends when its steps would have to be shorter than this (rad); `retreat`, when a step shrinks below this
fraction of the longest allowed.
"""
SINGULAR = 1e-3
"""A row of the Jacobian counts as linearly dependent if less than this fraction of it remains after orthogonalisation
against the rows before it.
"""
GROWTH = 0.3
"""Fraction by which the smallest distance should grow in one step of `retreat`."""
FLOOR = 0.7
"""Fraction of the smallest distance at the start that `retreat` must keep along the way."""
CUTS = 8
"""Maximum number of attempts at one step of `retreat`."""
PER_METER = 10.0
"""Longest step of `retreat` in rad per m of the smallest distance, and at most LONGEST: so short that the error of the
linearisation does not matter.
"""
LONGEST = 0.02
"""Longest step (rad, Euclidean) of `retreat`."""


class Surroundings(NamedTuple):
    """The arguments of `near`: a robot and its surroundings, and memory for one call; `motion` has two samples."""

    body: MotionBody
    world: Obstacles
    standing: Solids
    checked: Bits
    movers: Movers
    motion: Motion
    found: Array


@inlined
def distances(around: Surroundings, q: Array) -> tuple[int, float]:
    """Fill `around.found` with the distances at `q` (dof,); returns the number of rows and the smallest distance (m, at
    most WITHIN).
    """
    copy(q, around.motion.q[0])
    around.motion.placed[0] = 0
    count = near(
        around.body, around.world, around.standing, around.checked, around.movers, around.motion, WITHIN, around.found
    )
    least = WITHIN
    for row in range(count):
        least = min(least, around.found[row, 0])
    return count, least


@inlined
def length(v: Array) -> float:
    """Euclidean length."""
    total = 0.0
    for k in range(v.shape[0]):
        total += v[k] * v[k]
    return math.sqrt(total)


@inlined
def project(found: Array, count: int, growth: Array, step: Array) -> None:
    """Change `step` (dof,) so that each distance grows by at least `growth` (rows,) in m, or as nearly so as possible."""
    dof = step.shape[0]
    for _ in range(SWEEPS):
        for row in range(count):
            short, square = growth[row], 1e-12
            for k in range(dof):
                short -= found[row, GRADIENT + k] * step[k]
                square += found[row, GRADIENT + k] ** 2
            if short > 0.0 and square > 1e-6:
                for k in range(dof):
                    step[k] += RELAXED * short / square * found[row, GRADIENT + k]


@inlined
def keep_pose(chain: Chain, q: Array, work: Work, basis: Array, found: Array, count: int) -> None:
    """Project the gradients in `found` onto the null space of the tip's Jacobian at `q`, so that steps along them do
    not move the tip.
    """
    dof = q.shape[0]
    tip_pose(chain, q, work)
    tip_jacobian(chain, work)
    rank = 0
    for i in range(6):
        for k in range(dof):
            basis[rank, k] = work.jacobian[i, k]
        whole = length(basis[rank])
        for _ in range(2):  # orthogonalising twice suffices against rounding (Giraud et al., 2005)
            across(basis, rank, basis[rank])
        left = length(basis[rank])
        if left > SINGULAR * max(whole, SINGULAR):
            for k in range(dof):
                basis[rank, k] /= left
            rank += 1
    for row in range(count):
        across(basis, rank, found[row, GRADIENT:])


@inlined
def across(basis: Array, rank: int, v: Array) -> None:
    """Remove from `v` (dof,) its components along the first `rank` rows of `basis`, which are orthonormal."""
    for i in range(rank):
        along = 0.0
        for k in range(v.shape[0]):
            along += basis[i, k] * v[k]
        for k in range(v.shape[0]):
            v[k] -= along * basis[i, k]


@kernel
def clear_pose(
    chain: Chain, around: Surroundings, target: Array, enough: float, q: Array, deadline: NDArray[np.float64]
) -> float:
    """Move `q` (dof,), whose tip is at the pose `target` (4, 4), to a configuration with the same pose and more
    clearance.

    Returns its smallest distance (m): about the largest nearby, or at least `enough`. An arm without a redundant joint
    does not move.
    """
    dof = q.shape[0]
    work, now = make_work(dof), np.empty(2, np.int64)
    basis, growth = np.empty((7, dof)), np.empty(around.found.shape[0])
    trial, step = np.empty(dof), np.empty(dof)
    copy(q, trial)
    most, best = TURN, -np.inf
    for _ in range(STEPS):
        count, least = distances(around, trial)
        if least > best:
            best = least
            copy(trial, q)
        else:
            most *= 0.5
        if best >= enough or most < SHORTEST or dof <= 6 or passed(deadline, now):
            break
        if least < best:
            copy(q, trial)
            count, least = distances(around, trial)
        keep_pose(chain, trial, work, basis, around.found, count)
        for row in range(count):
            growth[row] = enough - around.found[row, 0]
        for k in range(dof):
            step[k] = 0.0
        project(around.found, count, growth, step)
        far = length(step)
        if far < 1e-6:
            break
        for k in range(dof):
            trial[k] = min(max(trial[k] + step[k] * min(1.0, most / far), chain.lower[k]), chain.upper[k])
        distance, angle = descend(chain, target, trial, work)
        if distance > TOLERANCE or angle > TOLERANCE:
            most *= 0.5
            copy(q, trial)
    return best


@inlined
def add_cuts(found: Array, count: int, step: Array, cuts: Array, size: int) -> int:
    """Append to `cuts` the distances in `found`, linearly extrapolated from the end of `step` (dof,) back to its start,
    with their gradients; returns the new number of cuts.
    """
    dof = step.shape[0]
    for row in range(count):
        if size < cuts.shape[0]:
            cuts[size, 0] = found[row, 0]
            for k in range(dof):
                cuts[size, 0] -= found[row, GRADIENT + k] * step[k]
                cuts[size, GRADIENT + k] = found[row, GRADIENT + k]
            size += 1
    return size


@kernel
def retreat(
    robot: RobotArrays,
    world: WorldArrays,
    memory: Memory,
    chain: Chain,
    around: Surroundings,
    direction: Array,
    way: Array,
    deadline: NDArray[np.float64],
) -> int:
    """Move from `way[0]` (`way` is (n, dof)), which is free of contact in the exact shapes, along `direction` (dof,)
    and past what is near, to a configuration that is free in the sphere model.

    The nearest point of a shape changes during a step. So a step that comes too close is taken back, and what it met
    becomes a constraint on the next attempt, as in the cutting-plane method (Kelley, "The cutting-plane method for
    solving convex programs", 1960). Returns how many rows of `way` lead to the free configuration; 0 if it is not
    reached.
    """
    checks = space(robot, world, memory)
    dof, now = direction.shape[0], np.empty(2, np.int64)
    step, single, still = np.empty(dof), np.empty(dof, np.float32), np.zeros(dof)
    cuts = np.empty((around.found.shape[0] * (CUTS + 1), around.found.shape[1]))
    growth = np.empty(cuts.shape[0])
    count, least = distances(around, way[0])
    floor = FLOOR * least
    for row in range(way.shape[0]):
        copy(way[row], single)
        if edge_free(checks, single, single):
            return row + 1
        if row + 1 == way.shape[0] or least <= 0.0 or passed(deadline, now):
            break
        size = add_cuts(around.found, count, still, cuts, 0)
        wanted = min((1.0 + GROWTH) * least, WITHIN)
        lowest = min(floor, least)
        most = min(LONGEST, PER_METER * least)
        taken = False
        for _ in range(CUTS):
            for k in range(dof):
                step[k] = most * direction[k]
            for i in range(size):
                growth[i] = wanted - cuts[i, 0]
            project(cuts, size, growth, step)
            far = length(step)
            if far < SHORTEST * most:
                break
            for k in range(dof):
                place = way[row, k] + step[k] * min(1.0, most / far)
                way[row + 1, k] = min(max(place, chain.lower[k]), chain.upper[k])
                step[k] = way[row + 1, k] - way[row, k]
            count, least = distances(around, way[row + 1])
            taken = least >= lowest
            if taken:
                break
            size = add_cuts(around.found, count, step, cuts, size)
            most *= 0.7
        if not taken:
            break
    return 0
