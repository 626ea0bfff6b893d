"""Exact geometry of a link: a few tight convex primitives that contain its surface.

A link is cut by planes, as in convex decomposition (Mamou and Ghorbel, "A simple and efficient approach for 3D mesh
approximate convex decomposition", 2009), and each cell is enclosed by the smallest box, cylinder, capsule or ball. The
one that protrudes most is cut next, where that leaves the least volume.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from zarm_contract.collision import CollisionPrimitive
from zarm_robot_import.body import Body
from zarm_robot_import.cells import piece
from zarm_robot_import.cutting import halves
from zarm_robot_import.directions import axes_of
from zarm_robot_import.merging import merged
from zarm_robot_import.partition import Partition
from zarm_robot_import.primitives import below, grown, written
from zarm_robot_import.protrusion import Measure
from zarm_trajectory.arrays import Array

COUNT = 130
"""Triangles in this many primitives are not cut further."""
_ROUNDS = 3
"""A link with so many is cut further once those that can be are merged, at most so many times in all."""
_ENOUGH = 1.25
"""A link whose primitives protrude by no more times as far as wanted is not tried in another way."""


def fit_primitives(body: Body) -> list[CollisionPrimitive]:
    """Primitives that contain all triangles of a link's surface.

    Collision and visual geometry are contained at once, or, where that protrudes too far and this less, first one and then
    what is left of the other.
    """
    measure = Measure(body)
    rows = _contained([body.triangles], body, measure)
    if len(body.shells) > 1 and measure.goal.excess(measure.all(rows)) > _ENOUGH:
        in_turn = _contained(body.shells, body, measure)
        rows = min(rows, in_turn, key=lambda rows: measure.goal.excess(measure.all(rows)))
    return [written(row) for row in rows]


def _contained(shells: Sequence[Array], body: Body, measure: Measure) -> Array:
    """Primitives (n, 17) that contain triangles (k, 3, 3), one shell after the other: those that are in a primitive
    already are left out.
    """
    axes = axes_of(body.surface.spread, body.triangles, np.empty((0, 3, 3)))
    rows = np.empty((0, 17))
    for shell in shells:
        held = np.zeros(len(shell), bool)
        for row in rows:
            inner = grown(row, -body.off)[None]
            held |= below(shell.reshape(-1, 3), inner).reshape(-1, 3).all(axis=1)
        if not held.all():
            left = shell[~held]
            whole = piece(left, np.unique(left.reshape(-1, 3), axis=0), axes, body)
            tried = _refined(Partition([whole], measure, rows), axes, body)
            rows = min(tried, key=Partition.excess).rows()
    return rows


def _refined(partition: Partition, axes: Array, body: Body) -> Iterator[Partition]:
    """The cells after each round of cutting and merging; there is another one while cells were too many for the goal, and
    merging left room for more.
    """
    for _ in range(_ROUNDS):
        partition = _cut(partition, axes, body)
        full = len(partition.cells) >= COUNT
        partition = merged(partition, axes, body)
        yield partition
        if not full or len(partition.cells) >= COUNT:
            break


def _cut(partition: Partition, axes: Array, body: Body) -> Partition:
    """The cells are cut until they protrude no more than wanted or are `COUNT`."""
    while len(partition.cells) < COUNT:
        if partition.excess() <= 1.0:
            break
        left = [cell for cell in partition.cells if not cell.final]
        if not left:
            break
        outs = partition.outs
        far = partition.out().most > partition.measure.goal.most
        worst = max(left, key=lambda cell: outs[cell].most if far else outs[cell].total)
        parts = halves(worst, axes, body, partition.measure.outside(worst.row))
        if parts:
            partition = partition.replaced((worst,), parts)
        else:
            worst.final = True
    return partition
