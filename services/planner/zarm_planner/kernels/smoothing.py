"""Shortcuts in time: pieces of a motion are replaced by the fastest ramps between their ends, if these are free.

Where obstacles block a single ramp, two ramps may pass that meet in a state somewhat beside the motion. Random bends
like this lead the motion around obstacles step by step. (Shortcuts: Hauser and Ng-Thow-Hing, "Fast smoothing of
manipulator trajectories using optimal bounded-acceleration shortcuts", 2010.)
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.kernels.arrays import Memory, RobotArrays, Space, WorldArrays, space
from zarm_geometry.kernels.collision import check
from zarm_geometry.kernels.compiled import inlined, kernel
from zarm_geometry.kernels.edge import divide, set_motion, subdivide, take
from zarm_geometry.kernels.simd import LANES, Lanes, larger, load, smaller, splat, store
from zarm_planner.kernels.clock import passed
from zarm_planner.kernels.ramps import Ramps, connect_states, in_range, least_time, state, time_between
from zarm_planner.kernels.random import uniform
from zarm_trajectory.arrays import Array

GAIN = 0.001
"""A shortcut that saves less than this fraction of the piece that it replaces is not checked."""
BENDS = 3
"""Attempts with a bend for each attempt without. They are cheaper, because most are too slow, which is known before any
check.
"""
BEND = 0.25
"""The most that a bend deviates from the motion: in position by this fraction of what each joint could turn at full
speed during the piece, in velocity by this fraction of full speed.
"""
SHORTEST = 0.01
"""Pieces shorter than this (s) are left alone."""
EMPTY = 1e-9
"""A ramp no longer than this (s) counts as empty."""
KEPT = 0.5
"""Fraction of the joints whose velocity a bend at a via leaves alone: if one of them determines the time, it is not
disturbed.
"""
REST = 0.05
"""A motion in which no joint exceeds this fraction of its full speed counts as nearly at rest. If the joint that takes
longest reverses at a via, other velocities of the other joints save no time; but a motion without a rest is better.
"""
EQUAL = 1e-6
"""A piece that ends a rest may take this fraction longer than the one it replaces."""
ENOUGH = 0.005
"""Shortcutting ends when the motion takes at most this fraction longer than the lower bound for any motion between its
ends.
"""

STALLED = 0.005
"""Shortcutting ends when recent attempts saved less than this fraction of the motion's time."""


@inlined
def set_joints(space: Space, ramps: Ramps, i: int, j: int, t: Lanes) -> None:
    """Write the positions of joint `j` at `t` s into ramp `i` to `Space.joints`."""
    zero = splat(0.0)
    first, last, a = np.float32(ramps.first[i, j]), np.float32(ramps.last[i, j]), np.float32(ramps.acceleration[i, j])
    x, v = np.float32(ramps.position[i, j]), np.float32(ramps.velocity[i, j])
    kept = max(np.float32(ramps.duration[i]) - first - last, np.float32(0.0))
    up, down = smaller(t, splat(first)), larger(t - (first + kept), zero)
    rate = v + a * up
    x_up = x + up * (v + rate) * 0.5
    store(space.joints, LANES * j, x_up + rate * larger(t - first, zero) - 0.5 * a * down * down)


@inlined
def ramp_free(space: Space, ramps: Ramps, i: int, lower: Array, upper: Array) -> bool:
    """Whether ramp `i` stays within the joints' ranges and is free, to the RESOLUTION of edges."""
    if not in_range(ramps, i, lower, upper):
        return False
    duration = ramps.duration[i]
    for j in range(space.dof):
        v, a = ramps.velocity[i, j], ramps.acceleration[i, j]
        peak = v + a * ramps.first[i, j]
        space.step[j] = duration * max(abs(v), abs(peak), abs(peak - a * ramps.last[i, j]))
    farthest = set_motion(space)
    top, whole = divide(space), True
    while top > LANES:
        taken = take(space, top)
        t = np.float32(duration) * load(space.middle, 0)
        for j in range(space.dof):
            set_joints(space, ramps, i, j, t)
        hit, near = check(space, whole)
        if hit != 0:
            return False
        whole = False
        top = subdivide(space, top, taken, near, farthest)
    return True


@inlined
def move(ramps: Ramps, source: int, target: int) -> None:
    """Copy ramp `source` over ramp `target`."""
    ramps.via[target], ramps.duration[target] = ramps.via[source], ramps.duration[source]
    for j in range(ramps.position.shape[1]):
        ramps.position[target, j], ramps.velocity[target, j] = ramps.position[source, j], ramps.velocity[source, j]
        ramps.acceleration[target, j] = ramps.acceleration[source, j]
        ramps.first[target, j], ramps.last[target, j] = ramps.first[source, j], ramps.last[source, j]


@inlined
def cut_before(ramps: Ramps, i: int, t: float, position: Array, velocity: Array) -> None:
    """Keep of ramp `i` only the part after `t` s, where its state is `position` and `velocity` (dof,)."""
    rest = ramps.duration[i] - t
    ramps.via[i] = ramps.via[i] and t <= EMPTY
    for j in range(position.shape[0]):
        ramps.position[i, j], ramps.velocity[i, j] = position[j], velocity[j]
        ramps.first[i, j] = max(ramps.first[i, j] - t, 0.0)
        ramps.last[i, j] = min(ramps.last[i, j], rest)
    ramps.duration[i] = rest


@inlined
def cut_after(ramps: Ramps, i: int, t: float) -> None:
    """Keep of ramp `i` only its first `t` s."""
    for j in range(ramps.position.shape[1]):
        ramps.last[i, j] = max(ramps.last[i, j] - (ramps.duration[i] - t), 0.0)
        ramps.first[i, j] = min(ramps.first[i, j], t)
    ramps.duration[i] = t


@inlined
def without_empty(ramps: Ramps, count: int) -> int:
    """Remove empty ramps from the first `count`; returns how many are left. Their vias move on to the next ramp."""
    kept, via = 0, False
    for i in range(count):
        via = via or ramps.via[i]
        if ramps.duration[i] > EMPTY:
            if kept < i:
                move(ramps, i, kept)
            ramps.via[kept] = via
            kept, via = kept + 1, False
    return kept


@inlined
def find(ramps: Ramps, count: int, t: float) -> tuple[int, float]:
    """The ramp that the motion is in at `t` s, and the time (s) since its start."""
    i = 0
    while i < count - 1 and t > ramps.duration[i]:
        t -= ramps.duration[i]
        i += 1
    return i, min(t, ramps.duration[i])


@inlined
def find_vias(ramps: Ramps, count: int, early: float, late: float) -> tuple[int, float, float]:
    """The first ramp that starts at a via between `early` and `late` (s), or -1; its time, or `late`; and the time of
    the next via, or `late`.
    """
    first, at, t = -1, late, 0.0
    for i in range(count):
        if t >= late:
            break
        if ramps.via[i] and t > early:
            if first >= 0:
                return first, at, t
            first, at = i, t
        t += ramps.duration[i]
    return first, at, late


@inlined
def bend(
    ramps: Ramps,
    count: int,
    via: int,
    t: float,
    piece: float,
    fastest: Array,
    random: NDArray[np.uint64],
    start: Array,
    end: Array,
    position: Array,
    velocity: Array,
) -> bool:
    """Write a state beside that at `t` s, through which the piece of `piece` s between `start` and `end` (dof,) is
    bent.

    If ramp `via` (-1 for none) starts at a via, the state is at that via with another velocity. Half of the states move
    more or less straight from start to end, because the motion may so far rest at a corner or a via. Returns whether
    the bend ends a rest.
    """
    size = uniform(random) ** 2  # mostly small
    straight = max(0.0, 2.0 * uniform(random) - 1.0)
    i, into = find(ramps, count, t)
    if via >= 0:
        i, into = via, 0.0
    state(ramps, i, into, position, velocity)
    before, after = 0.0, 0.0
    for j in range(position.shape[0]):
        before = max(before, abs(velocity[j]) / fastest[j])
        if via < 0 or uniform(random) >= KEPT:
            if via < 0:
                position[j] += (2.0 * uniform(random) - 1.0) * size * BEND * fastest[j] * piece
            velocity[j] += straight * ((end[j] - start[j]) / piece - velocity[j])
            velocity[j] += (2.0 * uniform(random) - 1.0) * size * BEND * fastest[j]
            velocity[j] = max(-fastest[j], min(velocity[j], fastest[j]))
        after = max(after, abs(velocity[j]) / fastest[j])
    return before < REST <= after


@inlined
def put(
    ramps: Ramps, count: int, i: int, early: float, k: int, late: float, new: int, end: Array, end_velocity: Array
) -> int:
    """Replace the motion between `early` s into ramp `i` and `late` s into ramp `k` by the `new` ramps at the end of
    the memory; returns the new number of ramps.

    `end` and `end_velocity` (dof,): the state `late` s into ramp `k`.
    """
    added = i + 1 + new - k
    if added > 0:
        for r in range(count - 1, k - 1, -1):
            move(ramps, r, r + added)
    elif added < 0:
        for r in range(k, count):
            move(ramps, r, r + added)
    cut_before(ramps, i + 1 + new, late, end, end_velocity)
    cut_after(ramps, i, early)
    for r in range(new):
        move(ramps, ramps.duration.shape[0] - new + r, i + 1 + r)
    return without_empty(ramps, count + added)


@kernel
def smooth(
    robot: RobotArrays,
    world: WorldArrays,
    memory: Memory,
    ramps: Ramps,
    count: int,
    limits: Array,
    begin: float,
    attempts: int,
    patience: int,
    random: NDArray[np.uint64],
    deadline: NDArray[np.float64],
) -> int:
    """Make the motion of the first `count` ramps faster, in place, by up to `attempts` shortcuts; returns its new
    number of ramps.

    It ends early when the motion is nearly as fast as any between its ends can be, see ENOUGH; when `patience` attempts
    saved less than STALLED; and at the deadline.

    Before `begin` (s) the motion stays as it is. `limits` (4, dof): lower and upper position (rad), velocity (rad/s),
    acceleration (rad/s^2). The motion still passes its vias, perhaps at other velocities.
    """
    checks = space(robot, world, memory)
    capacity, dof = ramps.position.shape
    lower, upper, fastest, strongest = limits[0], limits[1], limits[2], limits[3]
    now = np.empty(2, np.int64)
    start, start_velocity = np.empty(dof), np.empty(dof)
    middle, middle_velocity = np.empty(dof), np.empty(dof)
    end, end_velocity = np.empty(dof), np.empty(dof)
    first, second = capacity - 2, capacity - 1  # the candidate ramps
    slow, slow_after = np.zeros(1, np.int64), np.zeros(1, np.int64)
    i, early = find(ramps, count, begin)
    state(ramps, i, early, start, start_velocity)
    state(ramps, count - 1, ramps.duration[count - 1], end, end_velocity)
    least = 0.0
    for j in range(dof):
        time = least_time(end[j] - start[j], start_velocity[j], end_velocity[j], fastest[j], strongest[j])
        least = max(least, time if time < np.inf else 0.0)  # infinite if the start is faster than allowed
    period, marks = max(patience // 4, 1), np.full(4, np.inf)
    for attempt in range(attempts):
        if count + 5 > capacity or passed(deadline, now):
            break
        total = 0.0
        for i in range(count):
            total += ramps.duration[i]
        if total - begin <= (1.0 + ENOUGH) * least:
            break
        if attempt % period == 0:
            mark = attempt // period % 4
            if marks[mark] - total < STALLED * total:
                break
            marks[mark] = total
        early = begin + uniform(random) * (total - begin)
        late = begin + uniform(random) * (total - begin)
        if early > late:
            early, late = late, early
        bent = attempt % (BENDS + 1) != 0
        # Every other attempt includes an end of the motion, where accelerating sooner gains most.
        reach = attempt if bent else attempt // (BENDS + 1)
        if reach % 4 == 1:
            early = begin
        elif reach % 4 == 3:
            late = total
        via, at, next_via = find_vias(ramps, count, early, late)
        late = next_via if bent else at
        piece = late - early
        if piece < SHORTEST:
            continue
        i, early = find(ramps, count, early)
        k, late = find(ramps, count, late)
        state(ramps, i, early, start, start_velocity)
        state(ramps, k, late, end, end_velocity)
        most = (1.0 - GAIN) * piece
        if bent:
            if via < 0:
                at -= uniform(random) * piece
            if bend(ramps, count, via, at, piece, fastest, random, start, end, middle, middle_velocity) and via >= 0:
                most = (1.0 + EQUAL) * piece
            time = time_between(start, start_velocity, middle, middle_velocity, fastest, strongest, most, slow)
            if time > most:
                continue
            rest = time_between(middle, middle_velocity, end, end_velocity, fastest, strongest, most - time, slow_after)
            if (
                time + rest > most
                or not connect_states(
                    ramps, first, start, start_velocity, middle, middle_velocity, fastest, strongest, time
                )
                or not connect_states(
                    ramps, second, middle, middle_velocity, end, end_velocity, fastest, strongest, rest
                )
            ):
                continue
            ramps.via[second] = via >= 0
            if not ramp_free(checks, ramps, first, lower, upper) or not ramp_free(checks, ramps, second, lower, upper):
                continue
            count = put(ramps, count, i, early, k, late, 2, end, end_velocity)
            continue
        time = time_between(start, start_velocity, end, end_velocity, fastest, strongest, most, slow)
        if (
            time <= most
            and connect_states(ramps, second, start, start_velocity, end, end_velocity, fastest, strongest, time)
            and ramp_free(checks, ramps, second, lower, upper)
        ):
            count = put(ramps, count, i, early, k, late, 1, end, end_velocity)
    return count
