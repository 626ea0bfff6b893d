"""Configurations that follow a curve of poses from station to station, and among the ways to use its freedom those that
get on.

Where the pose leaves joints free, a breadth of configurations goes from station to station (beam search; Lowerre, "The
HARPY speech recognition system", 1976), each of which moves a little inside its freedom. All are reached by small steps
from the one before, so that no motion jumps from one branch of solutions to another.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.kernels.arrays import Memory, RobotArrays, Space, WorldArrays, space
from zarm_geometry.kernels.compiled import inlined, kernel
from zarm_geometry.kernels.edge import edge_free
from zarm_geometry.kernels.vectors import copy
from zarm_planner.kernels.clock import passed
from zarm_planner.kernels.inverse import TOLERANCE
from zarm_planner.kernels.pose_region import (
    Regions,
    RegionWork,
    choose_step,
    differentiate,
    enter,
    make_region_work,
    measure,
    move,
    time_apart,
)
from zarm_planner.kernels.random import uniform
from zarm_trajectory.arrays import Array, Single

STEPS = 12
"""Maximum number of steps from one station to the next."""
APART = 0.1
"""Rad: two configurations of a station that are nearer to each other in every joint count as one."""
SWEEPS = 30
"""How often each configuration of a path is moved to the middle of its neighbours."""
STILL = 1e-4
"""Rad: the sweeps end when none has moved further."""


class Breadth(NamedTuple):
    """What a search for a path may try: `ways` from each configuration besides the shortest, each up to `turn` rad aside;
    and how far, `jump` rad, a joint may move between two stations.
    """

    ways: int
    turn: float
    jump: float


@inlined
def set_station(regions: Regions, pose: Array) -> None:
    """Move the first region to `pose` (4, 4), and its axes with it."""
    for i in range(3):
        for j in range(3):
            regions.pose[0, i, j] = pose[i, j]
            regions.turn[0, i, j] = pose[j, i]
            regions.shift[0, i, j] = pose[j, i]
        regions.pose[0, i, 3] = pose[i, 3]


@inlined
def turn_aside(regions: Regions, q: Array, turn: float, random: NDArray[np.uint64], work: RegionWork) -> bool:
    """Move `q` (dof,) inside the region by a random step of up to `turn` rad, in place; returns whether it is there."""
    measure(regions, q, work)
    differentiate(regions, work)
    for k in range(q.shape[0]):
        work.wanted[k] = turn * (2.0 * uniform(random) - 1.0)
    choose_step(regions, q, 1e-6, work)
    move(regions, q, work)
    return enter(regions, q, STEPS, work) < TOLERANCE


@inlined
def edge_open(checks: Space, checked: bool, a: Array, b: Array, ends: Single) -> bool:
    """Whether the straight edge between two configurations (dof,) is free in spheres; any is unless it is `checked`."""
    if not checked:
        return True
    copy(a, ends[0])
    copy(b, ends[1])
    return edge_free(checks, ends[0], ends[1])


@inlined
def farthest(a: Array, b: Array) -> float:
    """How far (rad) the joint that moves most moves between two configurations (dof,)."""
    most = 0.0
    for k in range(a.shape[0]):
        most = max(most, abs(b[k] - a[k]))
    return most


@kernel
def follow(
    regions: Regions,
    robot: RobotArrays,
    world: WorldArrays,
    memory: Memory,
    checked: bool,
    poses: Array,
    starts: Array,
    speed: Array,
    breadth: Breadth,
    reached: Array,
    parents: NDArray[np.int64],
    counts: NDArray[np.int64],
    random: NDArray[np.uint64],
    deadline: NDArray[np.float64],
) -> int:
    """Follow `poses` (n, 4, 4) from the configurations `starts` (m, dof) at the first; returns how many stations, the
    first included, are reached.

    Writes up to w configurations of each station to `reached` (n, w, dof), cheapest first, their number to `counts`
    (n,), and which one of the station before leads to each to `parents` (n, w). The cost is the time at the joints'
    `speed` (dof,).
    """
    dof, width = starts.shape[1], reached.shape[1]
    checks, work = space(robot, world, memory), make_region_work(regions, dof)
    now, ends = np.empty(2, np.int64), np.empty((2, dof), np.float32)
    tried = width * (breadth.ways + 1)
    found, cost = np.empty((tried, dof)), np.empty(tried)
    origin, taken = np.empty(tried, np.int64), np.empty(tried, np.bool_)
    paid, paying = np.zeros(width), np.zeros(width)
    counts[0] = min(starts.shape[0], width)
    for w in range(counts[0]):
        copy(starts[w], reached[0, w])
        parents[0, w] = -1
    for station in range(1, poses.shape[0]):
        if passed(deadline, now):
            return station
        set_station(regions, poses[station])
        many = 0
        for w in range(counts[station - 1]):
            here = reached[station - 1, w]
            for way in range(breadth.ways + 1):
                q = found[many]
                for k in range(dof):
                    q[k] = here[k]
                    if station > 1:
                        q[k] += here[k] - reached[station - 2, parents[station - 1, w], k]
                    q[k] = min(max(q[k], regions.chain.lower[k]), regions.chain.upper[k])
                    work.inverse[k] = 1.0
                if enter(regions, q, STEPS, work) > TOLERANCE:
                    for k in range(dof):  # from where it is instead of from where it was heading
                        q[k] = here[k]
                    if enter(regions, q, STEPS, work) > TOLERANCE:
                        break
                if way > 0 and not turn_aside(regions, q, breadth.turn, random, work):
                    continue
                if farthest(here, q) > breadth.jump or not edge_open(checks, checked, here, q, ends):
                    continue
                cost[many] = paid[w] + time_apart(here, q, speed)
                origin[many] = w
                taken[many] = False
                many += 1
        kept = 0
        while kept < width:
            best = -1
            for i in range(many):
                if not taken[i] and (best < 0 or cost[i] < cost[best]):
                    best = i
            if best < 0:
                break
            taken[best] = True
            alike = False
            for w in range(kept):
                alike = alike or farthest(reached[station, w], found[best]) < APART
            if alike:
                continue
            copy(found[best], reached[station, kept])
            parents[station, kept], paying[kept] = origin[best], cost[best]
            kept += 1
        counts[station] = kept
        for w in range(kept):
            paid[w] = paying[w]
        if kept == 0:
            return station
    return len(poses)


@kernel
def straighten(
    regions: Regions,
    robot: RobotArrays,
    world: WorldArrays,
    memory: Memory,
    checked: bool,
    poses: Array,
    path: Array,
    deadline: NDArray[np.float64],
) -> None:
    """Make a path (n, dof) along `poses` (n, 4, 4) smooth, in place, by moving each configuration inside its freedom to
    the middle of its neighbours, over and over; both ends stay, except that the last follows the one before it.
    """
    n, dof = path.shape
    checks, work = space(robot, world, memory), make_region_work(regions, dof)
    now, ends, q = np.empty(2, np.int64), np.empty((2, dof), np.float32), np.empty(dof)
    for _ in range(SWEEPS):
        moved = 0.0
        for i in range(1, n):
            if passed(deadline, now):
                return
            set_station(regions, poses[i])
            measure(regions, path[i], work)
            differentiate(regions, work)
            after = min(i + 1, n - 1)
            for k in range(dof):
                middle = 0.5 * (path[i - 1, k] + path[after, k])
                if after == i:
                    middle = path[i - 1, k]
                work.wanted[k] = middle - path[i, k]
                work.inverse[k] = 1.0
            choose_step(regions, path[i], 1e-9, work)
            copy(path[i], q)
            move(regions, q, work)
            if enter(regions, q, STEPS, work) > TOLERANCE:
                continue
            if not edge_open(checks, checked, path[i - 1], q, ends) or not edge_open(
                checks, checked, q, path[after], ends
            ):
                continue
            moved = max(moved, farthest(path[i], q))
            copy(q, path[i])
        if moved < STILL:
            break


@kernel
def nearest_at(regions: Regions, pose: Array, q: Array) -> float:
    """Descend from `q` (dof,) to `pose` (4, 4), in place; returns by how much (m, rad) it is missed."""
    work = make_region_work(regions, q.shape[0])
    for k in range(q.shape[0]):
        work.inverse[k] = 1.0
    set_station(regions, pose)
    return enter(regions, q, 4 * STEPS, work)


@kernel
def deviations_along(regions: Regions, poses: Array, joints: Array, out: Array) -> None:
    """Write to `out` (n, 7) the deviations, in rad and m, of the first region's frame at each row of `joints` (n, dof)
    from each of `poses` (n, 4, 4).
    """
    work = make_region_work(regions, joints.shape[1])
    for n in range(joints.shape[0]):
        set_station(regions, poses[n])
        measure(regions, joints[n], work)
        for i in range(out.shape[1]):
            out[n, i] = work.deviation[i]
