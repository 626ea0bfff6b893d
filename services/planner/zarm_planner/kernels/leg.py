"""The fastest of several paths between two configurations, in one compiled call."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.kernels.arrays import Memory, RobotArrays, WorldArrays
from zarm_geometry.kernels.compiled import inlined, kernel
from zarm_geometry.kernels.vectors import copy
from zarm_planner.kernels.clock import seconds
from zarm_planner.kernels.rrt_connect import connect
from zarm_planner.kernels.shortcut import MOST_SHORTCUTS, shortcut
from zarm_planner.kernels.trees import Trees
from zarm_trajectory.arrays import Single

# Of the values tried, these gave the shortest motions for the same mean planning time over MotionBenchMaker's scenes. The
# easy half needs fewer than four paths; a cage, where the first paths may be twice as long as the best, up to all of them.
NEAR = 0.1
"""A path that takes at most this fraction longer than the straight line is good enough."""
ALIKE = 0.15
"""Paths that take at most this fraction longer than the fastest count as equally fast."""
AGREED = 3
"""The search ends once this many paths, including the fastest itself, are equally fast: a faster one is then unlikely.
"""
FAILURES = 4
"""The search ends after this many failed attempts without any path. The time of an attempt has a long tail, so the next
one is likely to be short.
"""
FEWEST = 20
"""Samples that any search may take."""


@inlined
def seconds_between(a: Single, b: Single, fastest: Single) -> float:
    """Time (s) from `a` to `b` with the joint that takes longest at its maximum speed `fastest` (dof,)."""
    most = 0.0
    for k in range(a.shape[0]):
        most = max(most, abs(b[k] - a[k]) / fastest[k])
    return most


@inlined
def inform(informed: Single, limits: Single, ends: Single, fastest: Single, least: float) -> None:
    """Set `informed` (2, dof) to the part of `limits` (2, dof) where a path of `least` s can pass."""
    for k in range(limits.shape[1]):
        middle, half = 0.5 * (ends[0, k] + ends[1, k]), 0.5 * least * fastest[k]
        informed[0, k] = max(limits[0, k], middle - half)
        informed[1, k] = min(limits[1, k], middle + half)


@kernel
def quickest_of(
    robot: RobotArrays,
    world: WorldArrays,
    memory: Memory,
    trees: Trees,
    limits: Single,
    weight: Single,
    ends: Single,
    fastest: Single,
    within: float,
    seeds: NDArray[np.uint64],
    most: int,
    deadline: NDArray[np.float64],
    spent: NDArray[np.float64],
) -> Single:
    """The fastest (n, dof) of the free paths found with `seeds` between `ends` (2, dof). A path is timed by moving
    along each edge with one joint at its maximum speed `fastest` (dof,). Not all seeds are tried, see NEAR and AGREED;
    each search ends after `most` samples. The path has no rows if none takes less than `within` s, FAILURES searches
    failed, or the deadline passed, before one was found.

    Samples are drawn only where a path faster than the best so far, or `within`, can pass: within a box that contains
    the informed set (Gammell, Srinivasa and Barfoot, "Informed RRT*", 2014); and once there is a path, no more than for
    the first one.

    Adds the seconds spent on searching and on shortcuts to `spent` (2,). `limits` and `weight` as in `connect`.
    """
    dof = ends.shape[1]
    goals = ends[1:]
    random, now = np.empty(1, np.uint64), np.empty(2, np.int64)
    best = np.empty((0, dof), np.float32)
    times, found = np.empty(seeds.shape[0]), 0
    straight, least = seconds_between(ends[0], ends[1], fastest), within
    informed = limits.copy()
    inform(informed, limits, ends, fastest, least)
    for tried in range(seeds.shape[0]):
        began = seconds(now)
        if began > deadline[0] or (found == 0 and tried == FAILURES):
            break
        random[0] = seeds[tried]
        path, samples = connect(robot, world, memory, trees, informed, weight, ends[0], goals, random, most, deadline)
        searched = seconds(now)
        spent[0] += searched - began
        rows = path.shape[0]
        if rows == 0:
            continue
        buffer = np.empty((rows + MOST_SHORTCUTS, dof), np.float32)
        for i in range(rows):
            copy(path[i], buffer[i])
        random[0] = seeds[tried]
        rows = shortcut(robot, world, memory, buffer, rows, random, deadline)
        spent[1] += seconds(now) - searched
        time = 0.0
        for i in range(rows - 1):
            time += seconds_between(buffer[i], buffer[i + 1], fastest)
        times[found] = time
        if found == 0:
            most = min(most, max(samples, FEWEST))
        found += 1
        if time < least:
            best, least = buffer[:rows], time
            inform(informed, limits, ends, fastest, least)
        alike = 0
        for i in range(found):
            if times[i] <= (1.0 + ALIKE) * least:
                alike += 1
        if least <= (1.0 + NEAR) * straight or alike == AGREED or (best.shape[0] == 0 and found == AGREED):
            break
    return best
