"""Shortcuts in time: pieces of a motion give way to the fastest ramps between their ends, where these are free."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from zarm_planner.kernels.arrays import Memory, RobotArrays, Space, WorldArrays, space
from zarm_planner.kernels.clock import passed
from zarm_planner.kernels.compiled import inlined, kernel
from zarm_planner.kernels.edge import edge_free
from zarm_planner.kernels.ramps import Array, Ramps, connect_states, state
from zarm_planner.kernels.random import uniform

STEP = 0.05
"""A ramp is checked as straight edges that take so long (s), or, where it is slow, turn no joint further than TURN; what it
bends between them, 6 mrad at 20 rad/s^2 and 5 mrad at any, is left to exact verification."""
TURN = 0.02
"""Rad; see STEP."""
GAIN = 0.005
"""A shortcut that saves less than this part of the piece it replaces is not worth a check."""
SHORTEST = 0.01
"""Pieces of less than this (s) are left as they are."""
EMPTY = 1e-9
"""Duration (s) of a ramp that is none."""


@inlined
def ramp_free(checks: Space, ramps: Ramps, i: int, lower: Array, upper: Array) -> bool:
    """Whether ramp `i` keeps inside the joints' ranges and free, looked at every STEP or TURN."""
    dof = lower.shape[0]
    position, velocity = np.empty(dof), np.empty(dof)
    before, after = np.empty(dof, np.float32), np.empty(dof, np.float32)
    fastest = 0.0
    for j in range(dof):
        peak = ramps.velocity[i, j] + ramps.acceleration[i, j] * ramps.first[i, j]
        fastest = max(
            fastest, abs(ramps.velocity[i, j]), abs(peak), abs(peak - ramps.acceleration[i, j] * ramps.last[i, j])
        )
    steps = max(2, math.ceil(ramps.duration[i] * min(1.0 / STEP, fastest / TURN)))
    for step in range(steps + 1):
        state(ramps, i, ramps.duration[i] * step / steps, position, velocity)
        for j in range(dof):
            if position[j] < lower[j] or position[j] > upper[j]:
                return False
            before[j] = after[j]
            after[j] = position[j]
        if step > 0 and not edge_free(checks, before, after):
            return False
    return True


@inlined
def move(ramps: Ramps, source: int, target: int) -> None:
    """Copy ramp `source` over ramp `target`."""
    ramps.duration[target] = ramps.duration[source]
    for j in range(ramps.position.shape[1]):
        ramps.position[target, j], ramps.velocity[target, j] = ramps.position[source, j], ramps.velocity[source, j]
        ramps.acceleration[target, j] = ramps.acceleration[source, j]
        ramps.first[target, j], ramps.last[target, j] = ramps.first[source, j], ramps.last[source, j]


@inlined
def cut_before(ramps: Ramps, i: int, t: float, position: Array, velocity: Array) -> None:
    """Leave of ramp `i` what comes after `t` s, where its state is `position` and `velocity`."""
    rest = ramps.duration[i] - t
    for j in range(position.shape[0]):
        ramps.position[i, j], ramps.velocity[i, j] = position[j], velocity[j]
        ramps.first[i, j] = max(ramps.first[i, j] - t, 0.0)
        ramps.last[i, j] = min(ramps.last[i, j], rest)
    ramps.duration[i] = rest


@inlined
def cut_after(ramps: Ramps, i: int, t: float) -> None:
    """Leave of ramp `i` its first `t` s."""
    for j in range(ramps.position.shape[1]):
        ramps.last[i, j] = max(ramps.last[i, j] - (ramps.duration[i] - t), 0.0)
        ramps.first[i, j] = min(ramps.first[i, j], t)
    ramps.duration[i] = t


@inlined
def without_empty(ramps: Ramps, count: int) -> int:
    """Close up over ramps of no duration among the first `count`; returns how many are left."""
    kept = 0
    for i in range(count):
        if ramps.duration[i] > EMPTY:
            if kept < i:
                move(ramps, i, kept)
            kept += 1
    return kept


@kernel
def smooth(
    robot: RobotArrays,
    world: WorldArrays,
    memory: Memory,
    ramps: Ramps,
    count: int,
    limits: Array,
    attempts: int,
    random: NDArray[np.uint64],
    deadline: NDArray[np.float64],
) -> int:
    """Make the motion of the first `count` ramps faster, in place, by up to `attempts` shortcuts; returns how many it has.

    `limits` (4, dof): lower and upper position (rad), velocity (rad/s), acceleration (rad/s^2).
    """
    checks = space(robot, world, memory)
    capacity, dof = ramps.position.shape
    lower, upper, fastest, strongest = limits[0], limits[1], limits[2], limits[3]
    now = np.empty(2, np.int64)
    start, start_velocity = np.empty(dof), np.empty(dof)
    end, end_velocity = np.empty(dof), np.empty(dof)
    spare = capacity - 1  # the ramp in hand
    for attempt in range(attempts):
        if count + 3 > capacity or passed(deadline, now):
            break
        total = 0.0
        for i in range(count):
            total += ramps.duration[i]
        early, late = uniform(random) * total, uniform(random) * total
        if early > late:
            early, late = late, early
        # Every other shortcut reaches to an end of the motion, where there is most to gain from starting sooner.
        if attempt % 4 == 1:
            early = 0.0
        elif attempt % 4 == 3:
            late = total
        piece = late - early
        if piece < SHORTEST:
            continue
        i = 0
        while i < count - 1 and early > ramps.duration[i]:
            early -= ramps.duration[i]
            i += 1
        k = 0
        while k < count - 1 and late > ramps.duration[k]:
            late -= ramps.duration[k]
            k += 1
        early, late = min(early, ramps.duration[i]), min(late, ramps.duration[k])
        state(ramps, i, early, start, start_velocity)
        state(ramps, k, late, end, end_velocity)
        if not connect_states(ramps, spare, start, start_velocity, end, end_velocity, fastest, strongest):
            continue
        if ramps.duration[spare] > (1.0 - GAIN) * piece or not ramp_free(checks, ramps, spare, lower, upper):
            continue
        # Ramps i to k give way to what is left of i, the new one, and what is left of k.
        added = i + 2 - k
        if added > 0:
            for r in range(count - 1, k - 1, -1):
                move(ramps, r, r + added)
        elif added < 0:
            for r in range(k, count):
                move(ramps, r, r + added)
        cut_before(ramps, i + 2, late, end, end_velocity)
        cut_after(ramps, i, early)
        move(ramps, spare, i + 1)
        count = without_empty(ramps, count + added)
    return count
