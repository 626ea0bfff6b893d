"""Exact geometry of a link: a few tight convex primitives that contain its surface.

A link is cut by planes, as in convex decomposition (Mamou and Ghorbel, "A simple and efficient approach for 3D mesh
approximate convex decomposition", 2009), and each cell is enclosed by the smallest box, cylinder, capsule or ball. The
one that protrudes most is cut next, where that leaves the least volume.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from zarm_contract.robot import CollisionPrimitive
from zarm_robot_import.body import Body
from zarm_robot_import.cells import piece
from zarm_robot_import.cutting import halves
from zarm_robot_import.directions import axes_of
from zarm_robot_import.merging import merge
from zarm_robot_import.partition import Partition
from zarm_robot_import.primitives import written
from zarm_robot_import.protrusion import MEAN, MOST, Measure

Array = NDArray[np.float64]

COUNT = 130
"""A link with this many primitives is not cut further."""
_ROUNDS = 3
"""A link with so many is cut further once those that can be are merged, at most so many times."""


def fit_primitives(body: Body) -> list[CollisionPrimitive]:
    """Primitives that contain all triangles of a link's surface."""
    axes = axes_of(body.surface.spread, body.triangles, np.empty((0, 3, 3)))
    partition = Partition([piece(body.triangles, body.surface.corners, axes, body)], Measure(body))
    for _ in range(_ROUNDS):
        _cut(partition, axes, body)
        full = len(partition.cells) >= COUNT
        merge(partition, axes, body)
        if not full or len(partition.cells) >= COUNT:
            break
    return [written(cell.row) for cell in partition.cells]


def _cut(partition: Partition, axes: Array, body: Body) -> None:
    """Cut cells until they protrude no more than wanted or are `COUNT`."""
    while len(partition.cells) < COUNT:
        out = partition.out()
        if out.most <= MOST and out.mean <= MEAN:
            break
        left = [cell for cell in partition.cells if not cell.final]
        if not left:
            break
        outs = partition.outs
        worst = max(left, key=lambda cell: outs[cell].most if out.most > MOST else outs[cell].total)
        parts = halves(worst, axes, body, partition.measure.outside(worst.row))
        if parts:
            partition.replace((worst,), parts)
        else:
            worst.final = True
