"""The two trees of a search. Configurations are stored in blocks of 16, so that 16 distances are computed at a time."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from zarm_geometry.kernels.compiled import inlined
from zarm_geometry.kernels.simd import LANES, below, load, pointer, splat, store
from zarm_trajectory.arrays import Index, Single

CAPACITY = 1 << 15
"""Nodes per tree. A search that fills one restarts, since a linear search over more nodes would cost more than it
gains.
"""
EVERYWHERE = np.float32(1e30)


class Trees(NamedTuple):
    """The tree of the start (0) and the tree of the goals (1).

    `nodes` (2, blocks, dof, 16): configurations; `parent` (2, CAPACITY): -1 for a root; `domain` (2, CAPACITY): a node
    is not extended towards samples further away than this; `size` (2,): number of nodes. `distances` (16,) is working
    memory.
    """

    nodes: Single
    parent: Index
    domain: Single
    size: Index
    distances: Single


def make_trees(dof: int) -> Trees:
    """Allocate memory for two trees. The pages of the large arrays cost nothing until a tree grows into them."""
    return Trees(
        nodes=np.empty((2, CAPACITY // LANES, dof, LANES), np.float32),
        parent=np.empty((2, CAPACITY), np.int32),
        domain=np.empty((2, CAPACITY), np.float32),
        size=np.zeros(2, np.int32),
        distances=np.empty(LANES, np.float32),
    )


@inlined
def add(trees: Trees, tree: int, q: Single, parent: int) -> int:
    """Add a node; returns its index."""
    i = int(trees.size[tree])
    for k in range(q.shape[0]):
        if i % LANES == 0:  # distances are computed for whole blocks, so initialise them
            for lane in range(LANES):
                trees.nodes[tree, i // LANES, k, lane] = 0.0
        trees.nodes[tree, i // LANES, k, i % LANES] = q[k]
    trees.parent[tree, i] = parent
    trees.domain[tree, i] = EVERYWHERE
    trees.size[tree] = i + 1
    return i


@inlined
def read(trees: Trees, tree: int, i: int, q: Single) -> None:
    """Copy a node's configuration into `q` (dof,)."""
    for k in range(q.shape[0]):
        q[k] = trees.nodes[tree, i // LANES, k, i % LANES]


@inlined
def nearest_node(trees: Trees, tree: int, q: Single, weight: Single) -> tuple[int, float]:
    """The node nearest to `q` (dof,) and its distance, Euclidean over the joints scaled by `weight` (dof,)."""
    dof = q.shape[0]
    nodes, target, scale = pointer(trees.nodes[tree]), pointer(q), pointer(weight)
    best, least = 0, EVERYWHERE
    size = trees.size[tree]
    for block in range((size + LANES - 1) // LANES):
        total = splat(0.0)
        for k in range(dof):
            apart = (load(nodes, (block * dof + k) * LANES) - target[k]) * scale[k]
            total = total + apart * apart
        if below(total, splat(least)) != 0:
            store(pointer(trees.distances), 0, total)
            for i in range(min(LANES, size - block * LANES)):
                if trees.distances[i] < least:
                    best, least = block * LANES + i, trees.distances[i]
    return best, math.sqrt(least)


@inlined
def path_through(trees: Trees, dof: int, a: int, b: int) -> Single:
    """The path (n, dof) from the start to node `a` of its tree, then to node `b` of the goals' tree, and on to the
    goal.
    """
    before = after = 0
    i = a
    while i >= 0:
        before += 1
        i = trees.parent[0, i]
    i = b
    while i >= 0:
        after += 1
        i = trees.parent[1, i]
    path = np.empty((before + after, dof), np.float32)
    row, i = before - 1, a
    while i >= 0:
        read(trees, 0, i, path[row])
        row, i = row - 1, trees.parent[0, i]
    row, i = before, b
    while i >= 0:
        read(trees, 1, i, path[row])
        row, i = row + 1, trees.parent[1, i]
    return path
