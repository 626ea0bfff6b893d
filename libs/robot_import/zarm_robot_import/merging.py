"""Merges cells of a link where one primitive does for two."""

from __future__ import annotations

from collections.abc import Iterable
from heapq import heappop, heappush
from itertools import combinations, count

from zarm_robot_import.body import Body
from zarm_robot_import.cells import Cell, touch, union
from zarm_robot_import.kernels.outside import within
from zarm_robot_import.partition import Partition
from zarm_trajectory.arrays import Array


def merged(partition: Partition, axes: Array, body: Body) -> Partition:
    """Neighbours are merged where nothing then protrudes further than wanted, or than it did; the pair whose union adds
    the least volume outside the body is tried first.
    """
    goal = partition.measure.goal
    far = body.points[body.out & (body.distance > goal.most)]
    far = far[~within(far, partition.rows(), 0.0)]  # and it stays outside
    pairs: list[tuple[float, int, Cell, Cell, Cell]] = []
    number = count()

    def consider(some: Iterable[tuple[Cell, Cell]]) -> None:
        for a, b in some:
            if touch(a.box, b.box):
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
        total = max(goal.mean * now.area, now.total)
        most = max(goal.most, outs[a].most, outs[b].most)
        out = partition.measure.one(both.row, partition.rows(a, b), most)
        if out.most > most or out.total > total - now.total + outs[a].total + outs[b].total:
            continue
        found = partition.replaced((a, b), (both,))  # in which others may lack the cover of a or b
        if found.out().total <= total and all(
            found.outs[cell].most <= max(goal.most, outs[cell].most) for cell in found.cells if cell is not both
        ):
            partition = found
            consider((cell, both) for cell in partition.cells if cell is not both)
    return partition
