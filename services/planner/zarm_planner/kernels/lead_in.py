"""From a state in motion to rest: ramps that brake, of which the first is taken that is free."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.kernels.arrays import Memory, RobotArrays, WorldArrays, space
from zarm_geometry.kernels.compiled import inlined, kernel
from zarm_planner.kernels.ramps import Array, Ramps, connect_states, in_range
from zarm_planner.kernels.random import uniform
from zarm_planner.kernels.smoothing import ramp_free

SHORTEST = 1e-6
"""Least duration (s) of a ramp that brakes."""
ASIDE = 0.5
"""The rests that are tried lie aside by at most what each joint could turn at full speed in this time (s)."""


@inlined
def straight(ramps: Ramps, i: int, strongest: Array) -> None:
    """Make ramp `i` brake along its own velocity, all joints coming to rest together."""
    dof = strongest.shape[0]
    time = SHORTEST
    for j in range(dof):
        time = max(time, abs(ramps.velocity[i, j]) / strongest[j])
    ramps.duration[i] = time
    for j in range(dof):
        ramps.acceleration[i, j], ramps.first[i, j], ramps.last[i, j] = -ramps.velocity[i, j] / time, time, 0.0


@inlined
def each_alone(ramps: Ramps, i: int, strongest: Array) -> None:
    """Make ramp `i` brake each joint as hard as it can."""
    dof = strongest.shape[0]
    ramps.duration[i] = SHORTEST
    for j in range(dof):
        velocity = ramps.velocity[i, j]
        ramps.acceleration[i, j] = -strongest[j] if velocity > 0.0 else strongest[j]
        ramps.first[i, j], ramps.last[i, j] = abs(velocity) / strongest[j], 0.0
        ramps.duration[i] = max(ramps.duration[i], ramps.first[i, j])


@inlined
def aside(
    ramps: Ramps,
    i: int,
    size: float,
    fastest: Array,
    strongest: Array,
    random: NDArray[np.uint64],
    start: Array,
    velocity: Array,
    end: Array,
    rest: Array,
) -> bool:
    """Make ramp `i` lead to a random rest between those of the two above or aside of them, by a part `size` of ASIDE at most.

    Returns whether there is such a ramp.
    """
    dof = strongest.shape[0]
    together = 0.0
    for j in range(dof):
        start[j], velocity[j] = ramps.position[i, j], ramps.velocity[i, j]
        together = max(together, abs(velocity[j]) / strongest[j])
    for j in range(dof):
        alone = abs(velocity[j]) / strongest[j]
        end[j] = start[j] + 0.5 * velocity[j] * (alone + uniform(random) * (together - alone))
        end[j] += (2.0 * uniform(random) - 1.0) * size * ASIDE * fastest[j]
        rest[j] = 0.0
    return connect_states(ramps, i, start, velocity, end, rest, fastest, strongest, np.inf)


@kernel
def brake(
    robot: RobotArrays,
    world: WorldArrays,
    memory: Memory,
    ramps: Ramps,
    i: int,
    bounds: Array,
    first: int,
    most: int,
    checked: bool,
    random: NDArray[np.uint64],
) -> int:
    """Make ramp `i`, whose position and velocity are given, the first of `most` ways to brake that is free.

    `bounds` (4, dof) as in `smooth`. Those before number `first` are passed over, and without `checked` a way need only be
    inside the joints' ranges. Returns the number of the way, -1 where there is none.
    """
    checks = space(robot, world, memory)
    lower, upper, fastest, strongest = bounds[0], bounds[1], bounds[2], bounds[3]
    dof = lower.shape[0]
    start, velocity, end, rest = np.empty(dof), np.empty(dof), np.empty(dof), np.empty(dof)
    ramps.via[i] = False
    for way in range(first, most):
        if way == 0:
            straight(ramps, i, strongest)
        elif way == 1:
            each_alone(ramps, i, strongest)
        elif not aside(ramps, i, way / most, fastest, strongest, random, start, velocity, end, rest):
            continue
        if ramp_free(checks, ramps, i, lower, upper) if checked else in_range(ramps, i, lower, upper):
            return way
    return -1
