"""RRT-Connect from one start to any of several goals, in one compiled call.

Kuffner and LaValle, "RRT-Connect: an efficient approach to single-query path planning", 2000. The tree with fewer nodes
grows next, and nodes at the boundary of the free space have a limited domain (Yershova, Jaillet, Simeon and LaValle,
"Dynamic-domain RRTs", 2005). Many samples are drawn near the ends: that is where arms have to get out of, between shelves
or bars.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.kernels.arrays import Memory, RobotArrays, WorldArrays, space
from zarm_geometry.kernels.compiled import inlined, kernel
from zarm_geometry.kernels.edge import edge_free
from zarm_geometry.kernels.vectors import between, copy
from zarm_planner.kernels.clock import passed
from zarm_planner.kernels.random import uniform
from zarm_planner.kernels.trees import CAPACITY, Trees, add, nearest_node, path_through, read
from zarm_trajectory.arrays import Single

# Distances in the metric of the trees (rad, joints weighted to a mean square of 1). Of steps from 0.5 to 5 and domains
# from 2 to unlimited, these were fastest at the median and at the 95th percentile over MotionBenchMaker's problems.
STEP = 1.0
"""Largest distance by which a sample extends a tree."""
CONNECT_STEP = 2.0
"""Longest step with which the other tree grows towards a new node."""
DOMAIN = 4.0
"""A node with a blocked edge is extended only towards samples within this distance."""
# Of shares from 0 to 0.6 and boxes from 1 to 3, these were among the fastest: into a cage, searches take 0.5 (Panda) and
# 0.75 (UR5) of the median time that samples drawn anywhere need, and no longer elsewhere.
LOCAL = 0.4
"""Share of samples that are drawn near an end."""
BOX = 1.5
"""The most by which a joint is away from the end there; a joint that moves little may be anywhere, or at a limit."""


@inlined
def _sample(
    limits: Single, weight: Single, start: Single, goals: Single, random: NDArray[np.uint64], target: Single
) -> None:
    """Draw `target` (dof,) near the start, near a goal, or anywhere within `limits`."""
    where = uniform(random)
    end = start if where < 0.5 * LOCAL else goals[int(uniform(random) * goals.shape[0])]
    for k in range(target.shape[0]):
        low, high = limits[0, k], limits[1, k]
        if where < LOCAL:
            near = end[k] + BOX / weight[k] * (2.0 * uniform(random) - 1.0)
            target[k] = min(max(near, low), high)
        else:
            target[k] = low + (high - low) * uniform(random)


@kernel
def connect(
    robot: RobotArrays,
    world: WorldArrays,
    memory: Memory,
    trees: Trees,
    limits: Single,
    weight: Single,
    start: Single,
    goals: Single,
    random: NDArray[np.uint64],
    most: int,
    deadline: NDArray[np.float64],
) -> tuple[Single, int]:
    """A free path (n, dof) from `start` (dof,) to one of `goals` (m, dof), and how many samples were drawn.

    It has no rows if none was found after `most` samples or before the deadline. Samples are drawn within `limits` (2,
    dof); `weight` (dof,) scales the joints in distances.
    """
    checks = space(robot, world, memory)
    dof = start.shape[0]
    now = np.empty(2, np.int64)
    for goal in range(goals.shape[0]):
        if edge_free(checks, start, goals[goal]):
            path = np.empty((2, dof), np.float32)
            copy(start, path[0])
            copy(goals[goal], path[1])
            return path, 0
    target, here, there = np.empty(dof, np.float32), np.empty(dof, np.float32), np.empty(dof, np.float32)
    grown = 0
    trees.size[0] = CAPACITY
    samples = 0
    while samples < most and not passed(deadline, now):
        samples += 1
        if max(trees.size[0], trees.size[1]) == CAPACITY:
            trees.size[0] = trees.size[1] = 0
            add(trees, 0, start, -1)
            for goal in range(goals.shape[0]):
                add(trees, 1, goals[goal], -1)
        _sample(limits, weight, start, goals, random, target)
        near, distance = nearest_node(trees, grown, target, weight)
        if distance > trees.domain[grown, near]:
            continue
        read(trees, grown, near, here)
        if distance > STEP:
            between(here, target, STEP / distance, target)
        if not edge_free(checks, here, target):
            trees.domain[grown, near] = DOMAIN
            continue
        new = add(trees, grown, target, near)

        other = 1 - grown
        near, distance = nearest_node(trees, other, target, weight)
        read(trees, other, near, here)
        steps = max(1, math.ceil(distance / CONNECT_STEP))
        while steps > 0 and trees.size[other] < CAPACITY:
            between(here, target, 1.0 / steps, there)
            if not edge_free(checks, here, there):
                break
            steps -= 1
            if steps > 0:
                near = add(trees, other, there, near)
                copy(there, here)
        if steps == 0:
            if grown == 0:
                return path_through(trees, dof, new, near), samples
            return path_through(trees, dof, near, new), samples
        if trees.size[other] < trees.size[grown]:
            grown = other
    return np.empty((0, dof), np.float32), samples
