"""Merges cells of a link where one primitive does for two."""

from __future__ import annotations

from collections.abc import Iterable
from heapq import heappop, heappush
from itertools import combinations, count

import numpy as np
from numpy.typing import NDArray

from zarm_robot_import.body import Body
from zarm_robot_import.cells import Cell, adjoin, union
from zarm_robot_import.kernels.outside import within
from zarm_robot_import.partition import Partition
from zarm_robot_import.protrusion import MEAN, MOST

Array = NDArray[np.float64]


def merge(partition: Partition, axes: Array, body: Body) -> None:
    """Merge neighbours where the result protrudes no more than wanted, or than both do.

    The pair whose union adds the least volume outside the body is tried first.
    """
    far = body.points[body.out & (body.distance > MOST)]
    far = far[~within(far, partition.rows(), 0.0)]  # and it stays outside
    pairs: list[tuple[float, int, Cell, Cell, Cell]] = []
    number = count()

    def consider(some: Iterable[tuple[Cell, Cell]]) -> None:
        for a, b in some:
            if adjoin(a, b):
                both = union(a, b, axes, body)
                if not within(far, both.row[None], 0.0).any():
                    heappush(pairs, (both.out - a.out - b.out, next(number), a, b, both))

    consider(combinations(partition.cells, 2))
    while pairs:
        _, _, a, b, both = heappop(pairs)
        outs = partition.outs
        if a not in outs or b not in outs:
            continue  # merged with another one
        now = partition.out()
        spare = max(MEAN * now.area, now.total) - now.total
        most = max(MOST, outs[a].most, outs[b].most)
        out = partition.measure.one(both.row, partition.rows(a, b), most)
        if out.most <= most and out.total <= spare + outs[a].total + outs[b].total:
            partition.replace((a, b), (both,))
            consider((cell, both) for cell in partition.others(both))
