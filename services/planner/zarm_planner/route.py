"""Through which configuration of each target a motion goes, and the short free path through them.

A pose can be reached in many ways, and a path to one costs a search. So paths are searched only between configurations
that the shortest route may still lead through: a straight line is the least that a path between two can be (Dellin and
Srinivasa, "A unifying formalism for shortest path problems with expensive edge evaluations via lazy best-first search
over paths with edge selectors", 2016).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zarm_planner.ends import End, Snapshot
from zarm_planner.motion import Array
from zarm_planner.search import search
from zarm_planner.shorten import shorten
from zarm_planner.stop import Stop
from zarm_planner.watch import Watch

_LEGS = 4
"""Per target, so many pairs of configurations are tried to be joined before what was found so far has to do."""
_TRIES = 4
"""Paths between two, of which the shortest counts; on MotionBenchMaker's problems it is about a tenth shorter than one alone."""
_SAMPLES = 1000
"""Samples after which such a try is given up, some milliseconds; nine of ten problems of MotionBenchMaker take fewer."""
_MOST_SAMPLES = 100_000
"""Samples after which a search to any of a target's configurations is given up, some seconds."""


@dataclass(frozen=True)
class Route:
    """A free path (n, dof) from the start; it reaches the k-th target in its row `rows[k]`."""

    path: Array
    rows: tuple[int, ...]


def find_route(
    snapshot: Snapshot, start: End, targets: Sequence[Sequence[End]], seed: int, stop: Stop, watch: Watch
) -> Route | None:
    """A short route from `start` through one end of each target, in their order; None where none was found soon.

    The same seed gives the same route. Raises what `stop` raises.
    """
    legs = _Legs(snapshot, seed, stop, watch)
    chain = _shortest_chain(legs, [[start], *targets]) or _any_chain(legs, start, targets)
    if chain is None:
        return None
    path, rows = [*start.edge], []
    for end, leg in chain:
        path += [*leg[1 if path and np.array_equal(path[-1], leg[0]) else 0 :], *end.edge]
        rows.append(len(path) - 1)
        if end.edge.size:
            path.append(end.free)
    path = path[: rows[-1] + 1]
    return Route(np.array(path), tuple(rows))


@dataclass
class _Legs:
    """Searches paths between ends, each (n, dof) from one's free configuration to the other's."""

    snapshot: Snapshot
    seed: int
    stop: Stop
    watch: Watch

    def between(self, start: End, end: End) -> Array | None:
        """The shortest of a few paths; None where the first was not found soon."""
        best, shortest, straight = None, np.inf, float(np.linalg.norm(end.free - start.free))
        for seed in range(_TRIES * self.seed, _TRIES * (self.seed + 1)):
            if shortest <= straight or (path := self._path(start, end.free[None], seed, _SAMPLES)) is None:
                break
            if (length := _length(path)) < shortest:
                best, shortest = path, length
        return best

    def to_any(self, start: End, ends: Sequence[End]) -> tuple[End, Array] | None:
        """The first path found to any of the ends, and that end."""
        free = np.array([end.free for end in ends])
        if (path := self._path(start, free, self.seed, _MOST_SAMPLES)) is None:
            return None
        return ends[int(np.argmin(np.abs(free - path[-1]).max(axis=1)))], path

    def _path(self, start: End, goals: Array, seed: int, most: int) -> Array | None:
        model, world = self.snapshot.model, self.snapshot.world
        with self.watch.stage("search"):
            path = search(model, world, start.free, goals, seed=seed, stop=self.stop, most=most)
        self.stop.check()
        if path is None:
            return None
        with self.watch.stage("shorten"):
            return shorten(model, world, path, seed=seed, stop=self.stop)


Chain = list[tuple[End, Array]]
"""For each target the end that is gone through, and the leg that leads there."""


def _shortest_chain(legs: _Legs, layers: Sequence[Sequence[End]]) -> Chain | None:
    """The shortest chain through the layers, of which the first is the start; None where _LEGS tries each found none."""
    free = [np.array([end.free for end in ends]) for ends in layers]
    # From each end of a layer to each of the next: the length of the leg, or until that is known the least it can be.
    costs = [np.linalg.norm(b[None] - a[:, None], axis=2) for a, b in itertools.pairwise(free)]
    known: list[dict[tuple[int, int], Array | None]] = [{} for _ in costs]
    tries = _LEGS * len(costs)
    while (pairs := _cheapest(costs)) is not None:
        step = next((k for k, pair in enumerate(pairs) if pair not in known[k]), None)
        if step is None:
            found = [(layers[k + 1][to], known[k][at, to]) for k, (at, to) in enumerate(pairs)]
            return [(end, leg) for end, leg in found if leg is not None]
        if tries == 0:  # from now on only what is known counts
            for cost, pairs_known in zip(costs, known, strict=True):
                unknown = np.ones(cost.shape, bool)
                unknown[tuple(np.array([*pairs_known], int).reshape(-1, 2).T)] = False
                cost[unknown] = np.inf
            continue
        tries -= 1
        at, to = pairs[step]
        leg = known[step][at, to] = legs.between(layers[step][at], layers[step + 1][to])
        costs[step][at, to] = np.inf if leg is None else _length(leg)
    return None


def _cheapest(costs: Sequence[Array]) -> list[tuple[int, int]] | None:
    """From which end to which of the next layer the cheapest way leads, step by step; None where every way is blocked."""
    total = np.zeros(1)
    previous = []
    for cost in costs:
        sums = total[:, None] + cost
        previous.append(np.argmin(sums, axis=0))
        total = np.min(sums, axis=0)
    if not np.isfinite(total.min()):
        return None
    to, pairs = int(np.argmin(total)), []
    for best in reversed(previous):
        at = int(best[to])
        pairs.append((at, to))
        to = at
    return pairs[::-1]


def _any_chain(legs: _Legs, start: End, targets: Sequence[Sequence[End]]) -> Chain | None:
    """A chain of the first paths found, target by target."""
    chain: Chain = []
    for ends in targets:
        if (found := legs.to_any(start, ends)) is None:
            return None
        chain.append(found)
        start = found[0]
    return chain


def _length(path: Array) -> float:
    """Euclidean, rad."""
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
