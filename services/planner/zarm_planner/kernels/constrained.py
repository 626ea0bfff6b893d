"""RRT-Connect and shortcuts on the manifold of a path constraint, each in one compiled call.

Berenson, Srinivasa, Ferguson and Kuffner, "Manipulation planning on constraint manifolds", 2009 (CBiRRT). Unlike there,
samples are projected onto the manifold before a tree grows towards them, so that the nearest node is also near along
the manifold.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.kernels.arrays import Memory, RobotArrays, Space, WorldArrays, space
from zarm_geometry.kernels.compiled import inlined, kernel
from zarm_geometry.kernels.edge import edge_free
from zarm_geometry.kernels.vectors import apart, copy
from zarm_planner.kernels.clock import passed
from zarm_planner.kernels.manifold import ConstraintArrays, Workspace, advance, make_workspace, project
from zarm_planner.kernels.random import uniform
from zarm_planner.kernels.trees import CAPACITY, Trees, add, nearest_node, path_through, read
from zarm_trajectory.arrays import Single

EXTENSION = 1.0
"""Distance (rad, Euclidean) after which a tree stops growing towards a sample."""
ROWS = 4096
"""Maximum number of rows of a path."""
ATTEMPTS = 200
"""Maximum number of shortcuts tried."""
PATIENCE = 40
"""Shortcutting ends after this many failed attempts in a row."""
GAIN = 0.01
"""A shortcut that saves less than this fraction of the piece that it replaces is not checked."""


@kernel
def walk(constraint: ConstraintArrays, a: Single, b: Single, longest: float, rows: Single, workspace: Workspace) -> int:
    """Write the configurations of the path along the manifold from `a` (excluded) to `b` into `rows` (n, dof); returns
    their number.

    Returns 0 if the path does not reach `b`, or is longer than `longest` (rad, Euclidean).
    """
    count, length = 0, 0.0
    here = a
    while count < rows.shape[0]:
        if not advance(constraint, here, b, rows[count], workspace):
            return 0
        length += apart(here, rows[count])
        if length + apart(rows[count], b) > longest:
            return 0
        here = rows[count]
        count += 1
        if apart(here, b) == 0.0:
            return count
    return 0


@kernel
def straight_ways(constraint: ConstraintArrays, start: Single, goals: Single, found: NDArray[np.bool_]) -> None:
    """Write to `found` (m,) to which of `goals` (m, dof) the path along the manifold from `start` (dof,) leads, which need not be
    free.
    """
    workspace, rows = make_workspace(start.shape[0]), np.empty((ROWS, start.shape[0]), np.float32)
    for goal in range(goals.shape[0]):
        found[goal] = walk(constraint, start, goals[goal], 1e9, rows, workspace) > 0


@inlined
def walk_free(checks: Space, a: Single, rows: Single, count: int) -> bool:
    """Whether the path from `a` along the first `count` rows is free."""
    here = a
    for i in range(count):
        if not edge_free(checks, here, rows[i]):
            return False
        here = rows[i]
    return True


@kernel
def connect_constrained(
    robot: RobotArrays,
    world: WorldArrays,
    memory: Memory,
    trees: Trees,
    constraint: ConstraintArrays,
    limits: Single,
    weight: Single,
    start: Single,
    goals: Single,
    random: NDArray[np.uint64],
    most: int,
    deadline: NDArray[np.float64],
) -> Single:
    """A free path (n, dof) on the manifold from `start` (dof,) to one of `goals` (m, dof), all of which are on it.

    It has no rows if none was found after `most` samples or before the deadline. Samples are drawn within `limits` (2,
    dof); `weight` (dof,) scales the joints in distances.
    """
    checks, dof = space(robot, world, memory), start.shape[0]
    workspace = make_workspace(dof)
    now = np.empty(2, np.int64)
    rows = np.empty((ROWS, dof), np.float32)
    for goal in range(goals.shape[0]):
        count = walk(constraint, start, goals[goal], 1e9, rows, workspace)
        if count > 0 and walk_free(checks, start, rows, count):
            path = np.empty((count + 1, dof), np.float32)
            copy(start, path[0])
            for i in range(count):
                copy(rows[i], path[i + 1])
            return path
    sample = np.empty(dof)
    target, here, there = np.empty(dof, np.float32), np.empty(dof, np.float32), np.empty(dof, np.float32)
    grown = samples = 0
    trees.size[0] = CAPACITY
    while samples < most and not passed(deadline, now):
        samples += 1
        if max(trees.size[0], trees.size[1]) + ROWS > CAPACITY:
            trees.size[0] = trees.size[1] = 0
            add(trees, 0, start, -1)
            for goal in range(goals.shape[0]):
                add(trees, 1, goals[goal], -1)
        for k in range(dof):
            sample[k] = limits[0, k] + (limits[1, k] - limits[0, k]) * uniform(random)
        if not project(constraint, sample, workspace):
            continue
        copy(sample, target)
        new, _ = nearest_node(trees, grown, target, weight)
        read(trees, grown, new, here)
        length, moved = 0.0, False
        while (
            length < EXTENSION
            and advance(constraint, here, target, there, workspace)
            and edge_free(checks, here, there)
        ):
            new, moved = add(trees, grown, there, new), True
            length += apart(here, there)
            copy(there, here)
            if apart(here, target) == 0.0:
                break
        if not moved:
            continue
        copy(here, target)

        other = 1 - grown
        near, _ = nearest_node(trees, other, target, weight)
        read(trees, other, near, here)
        while (
            trees.size[other] < CAPACITY
            and advance(constraint, here, target, there, workspace)
            and edge_free(checks, here, there)
        ):
            if apart(there, target) == 0.0:
                return path_through(trees, dof, new, near) if grown == 0 else path_through(trees, dof, near, new)
            near = add(trees, other, there, near)
            copy(there, here)
        if trees.size[other] < trees.size[grown]:
            grown = other
    return np.empty((0, dof), np.float32)


@kernel
def shortcut_constrained(
    robot: RobotArrays,
    world: WorldArrays,
    memory: Memory,
    constraint: ConstraintArrays,
    path: Single,
    count: int,
    random: NDArray[np.uint64],
    deadline: NDArray[np.float64],
) -> int:
    """Shorten the path in the first `count` rows of `path` (ROWS, dof) in place; returns its new number of rows."""
    checks, dof = space(robot, world, memory), path.shape[1]
    workspace = make_workspace(dof)
    now = np.empty(2, np.int64)
    rows = np.empty((ROWS, dof), np.float32)
    failed = tried = 0
    while count > 2 and failed < PATIENCE and tried < ATTEMPTS and not passed(deadline, now):
        tried += 1
        failed += 1
        # Pieces of all lengths are tried: long ones save most, short ones round corners.
        span = int(2.0 * math.exp(uniform(random) * math.log(0.5 * count)))
        i = int(uniform(random) * (count - span))
        j = i + span
        piece = 0.0
        for v in range(i, j):
            piece += apart(path[v], path[v + 1])
        longest = (1.0 - GAIN) * piece
        if apart(path[i], path[j]) > longest:
            continue
        new = walk(constraint, path[i], path[j], longest, rows, workspace)
        moved = new - (j - i)  # the new rows replace those after `i`, up to `j`
        if new == 0 or count + moved > path.shape[0] or not walk_free(checks, path[i], rows, new):
            continue
        failed = 0
        if moved > 0:
            for v in range(count - 1, j, -1):
                copy(path[v], path[v + moved])
        else:
            for v in range(j + 1, count):
                copy(path[v], path[v + moved])
        for v in range(new):
            copy(rows[v], path[i + 1 + v])
        count += moved
    return count
