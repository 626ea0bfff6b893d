"""From a moving state to rest: the first of several braking ramps that is free."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.kernels.arrays import Memory, RobotArrays, WorldArrays, space
from zarm_geometry.kernels.compiled import inlined, kernel
from zarm_planner.kernels.ramps import Ramps, connect_states, in_range, time_between
from zarm_planner.kernels.random import uniform
from zarm_planner.kernels.smoothing import ramp_free
from zarm_trajectory.arrays import Array

SHORTEST = 1e-6
"""Shortest duration (s) of a braking ramp."""
ASIDE = 0.5
"""The randomly tried rest positions lie aside by at most what each joint moves at full speed in this time (s)."""


@inlined
def straight(ramps: Ramps, i: int, strongest: Array) -> None:
    """Make ramp `i` brake straight along its velocity, with all joints coming to rest together."""
    dof = strongest.shape[0]
    time = SHORTEST
    for j in range(dof):
        time = max(time, abs(ramps.velocity[i, j]) / strongest[j])
    ramps.duration[i] = time
    for j in range(dof):
        ramps.acceleration[i, j], ramps.first[i, j], ramps.last[i, j] = -ramps.velocity[i, j] / time, time, 0.0


@inlined
def each_alone(ramps: Ramps, i: int, strongest: Array) -> None:
    """Make ramp `i` brake each joint as hard as possible."""
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
    """Make ramp `i` lead to a random rest position between those of the two functions above, moved aside by at most the
    fraction `size` of ASIDE.

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
    time = time_between(start, velocity, end, rest, fastest, strongest, np.inf, np.zeros(1, np.int64))
    return connect_states(ramps, i, start, velocity, end, rest, fastest, strongest, time)


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
    """Make ramp `i`, whose position and velocity are given, the first of `most` braking ramps that is free.

    `bounds` (4, dof) as `limits` in `smooth`. Ramps before number `first` are skipped; without `checked`, a ramp only
    needs to stay within the joints' ranges. Returns the number of the ramp, -1 if there is none.
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
