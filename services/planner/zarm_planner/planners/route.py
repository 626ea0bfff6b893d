"""Chooses a configuration for each target, and finds a quick free path through them.

A pose can be reached in many ways, and each path costs a search. So paths are searched only between configurations that
the quickest route may still pass: no path between two is quicker than a straight line (Dellin and Srinivasa, "A
unifying formalism for shortest path problems with expensive edge evaluations via lazy best-first search over paths with
edge selectors", 2016).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from zarm_contract.errors import PlanningFailed
from zarm_planner.context import PlanningContext
from zarm_planner.deadline import Deadline
from zarm_planner.goals.ends import End
from zarm_planner.goals.problem import PlanningProblem
from zarm_planner.kernels.leg_times import path_time, straight_times
from zarm_planner.search.disconnection import find_disconnection
from zarm_trajectory.arrays import Array
from zarm_trajectory.limits import Limits

_LEGS = 4
"""Pairs of configurations per target between which a path is searched before the best so far is used, plus one for each
further pose of a goal set.
"""
_GAIN = 0.03
"""A further leg is searched only if it could make the route faster by this fraction."""
_SOON_S = 0.3
"""Time (s) after which a search to any of several configurations pauses for a proof that there is no path."""
_PROOF_S = 0.5
"""Time limit (s) of the search for a proof."""


class Paths(Protocol):
    """Paths (n, dof) whose straight edges are free in spheres. The same seed gives the same paths; a deadline may
    raise.
    """

    def between(self, start: Array, goal: Array, within: float, *, alone: bool) -> Array | None:
        """A short path between two configurations (dof,); None if none was found soon. One that must take longer than
        `within` s is of no use. If it is `alone`, the search may take longer: no other leg can take its place.
        """

    def to_any(self, start: Array, goals: Array, until: Deadline) -> Array | None:
        """A path to one of `goals` (m, dof); None if none was found soon enough, or at the deadline `until`."""


@dataclass(frozen=True)
class Route:
    """A free path (n, dof) from the start; it reaches the k-th target in its row `rows[k]`."""

    path: Array
    rows: tuple[int, ...]

    @property
    def vias(self) -> tuple[int, ...]:
        """The rows of the targets on the way to the last one."""
        return self.rows[:-1]


def find_route(paths: Paths, problem: PlanningProblem, context: PlanningContext) -> Route | None:
    """A quick route through one end of each target, in order.

    None if none was found. Raises PlanningFailed (`no_path`) if it is proven that there is none.
    """
    start, layers = problem.start, [[problem.start], *problem.targets]
    chain = _quickest_chain(paths, layers, context.limits) or _any_chain(paths, layers, context)
    if chain is None:
        return None
    path, rows = [*start.way[::-1]], []
    for end, leg in chain:
        path += [*leg[1 if path and np.array_equal(path[-1], leg[0]) else 0 :], *end.way]
        rows.append(len(path) - 1)
        if len(end.way):
            path += [*end.way[-2::-1], end.free]
    path = path[: rows[-1] + 1]
    return Route(np.array(path), tuple(rows))


Chain = list[tuple[End, Array]]
"""For each target the end that is passed, and the leg that leads there."""


def _quickest_chain(paths: Paths, layers: Sequence[Sequence[End]], limits: Limits) -> Chain | None:
    """The quickest chain through the layers, the first of which is the start; None if _LEGS tries each found none."""
    free = [np.array([end.free for end in ends]) for ends in layers]
    # The time of the leg from each end of a layer to each end of the next, or a lower bound until it is planned.
    last = len(free) - 2
    rests = [(leg == 0) + (leg == last) for leg in range(last + 1)]
    costs = [
        straight_times(a, b, limits.velocity, limits.acceleration, ends)
        for (a, b), ends in zip(itertools.pairwise(free), rests, strict=True)
    ]
    found = [np.full(cost.shape, math.inf) for cost in costs]  # the same, of the legs that are planned
    legs: list[dict[tuple[int, int], Array | None]] = [{} for _ in costs]
    tries = sum(_LEGS - 1 + len({end.pose for end in ends}) for ends in layers[1:])
    while True:
        (least, hoped), (time, chain) = _cheapest(costs), _cheapest(found)
        if tries == 0 or not least < (1.0 - _GAIN) * time:
            break
        tries -= 1
        step = next(k for k, pair in enumerate(hoped) if pair not in legs[k])
        at, to = hoped[step]
        within = time - (least - costs[step][at, to])
        begin, end, alone = layers[step][at].free, layers[step + 1][to].free, costs[step].size == 1
        leg = legs[step][at, to] = paths.between(begin, end, within, alone=alone)
        took = math.inf if leg is None else path_time(leg, limits.velocity, limits.acceleration, rests[step])
        costs[step][at, to] = found[step][at, to] = took
    joined = [(layers[k + 1][to], legs[k].get((at, to))) for k, (at, to) in enumerate(chain)]
    return [(end, leg) for end, leg in joined if leg is not None] if math.isfinite(time) else None


def _cheapest(costs: Sequence[Array]) -> tuple[float, list[tuple[int, int]]]:
    """The time of the quickest chain, and the ends of consecutive layers that it joins, step by step; infinite if every
    chain is blocked.
    """
    total, previous = costs[0][0], []  # the first layer is the start alone
    for cost in costs[1:]:
        sums = total[:, None] + cost
        previous.append(sums.argmin(axis=0))
        total = sums.min(axis=0)
    to, pairs = int(total.argmin()), []
    time = float(total[to])
    for best in reversed(previous):
        at = int(best[to])
        pairs.append((at, to))
        to = at
    return time, [(0, to), *pairs[::-1]]


def _any_chain(paths: Paths, layers: Sequence[Sequence[End]], context: PlanningContext) -> Chain | None:
    """A chain of the first paths found, target by target."""
    (start,), *_ = layers
    chain: Chain = []
    for before, ends in itertools.pairwise(layers):
        free = np.array([end.free for end in ends])
        soon = context.deadline.sooner(_SOON_S)
        path = paths.to_any(start.free, free, soon)
        if path is None:
            unfinished = soon.passed
            found = "the goal" if ends[0].pose is None else f"any of the {len(ends)} solutions found for the goal"
            _check_connected(context, np.array([end.free for end in before]), free, found)
            if unfinished:  # otherwise the same search would give up once more
                path = paths.to_any(start.free, free, context.deadline)
        if path is None:
            return None
        start = ends[int(np.argmin(np.abs(free - path[-1]).max(axis=1)))]
        chain.append((start, path))
    return chain


def _check_connected(context: PlanningContext, starts: Array, goals: Array, called: str) -> None:
    """Raises PlanningFailed if it can be proven that no path leads from any of `starts` (n, dof) to any of `goals` (m,
    dof).
    """
    with context.timer.stage("search"):
        deadline = context.deadline.sooner(_PROOF_S)
        found = find_disconnection(context.model, context.world, starts, goals, deadline)
    if found is not None:
        joints, objects = " and ".join(found.joints), " or ".join(found.objects)
        raise PlanningFailed(
            f"there is no path to {called}: {joints} would have to turn through {objects}, wherever the other joints are; "
            "move what is in the way, or choose another goal",
            code="no_path",
        )
