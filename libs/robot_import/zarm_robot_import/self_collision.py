"""Which pairs of links can collide, judged on the original meshes; a pair in doubt stays checked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from zarm_geometry.shapes import distance, link_shape
from zarm_robot_import.contacts import SAMPLES, Contacts
from zarm_robot_import.fitting import Fitted
from zarm_trajectory.arrays import Array

CLEAR = 0.005
"""Meshes that come no closer than this (m), in samples and in a search from the closest of them, are assumed never to
meet.
"""
MOST_TAKEN = 0.3
"""Largest share of all configurations that covers may block for a pair of links before the search ignores it."""
_CROWD = 300
"""Configurations in which the exact geometry is examined."""
_SEARCHES = 3
_STEPS = 40


@dataclass(frozen=True)
class Pair:
    """Two links, whether they are left out of self-collision, and why or why not."""

    first: str
    second: str
    ignored: bool
    reason: str
    exact: bool = False
    """Whether the search leaves it to the exact check, because the covers of both nearly always overlap."""


class Pairs:
    """The links of an arm with their exact geometry and covers.

    `travel` is how far (m) a gripper moves its links; the configurations have it at one opening.
    """

    def __init__(self, contacts: Contacts, fitted: Sequence[Fitted], travel: Mapping[str, float]) -> None:
        self._contacts = contacts
        self._travel = travel
        self._fitted = {link.link: link for link in sorted(fitted, key=lambda link: contacts.body[link.link])}
        self._parts = {
            link.link: [link_shape(link.link, primitive) for primitive in link.primitives] for link in fitted
        }

    def judged(self) -> list[Pair]:
        """Every pair of links on different bodies."""
        found = []
        for first, second in combinations(self._fitted, 2):
            one, other = self._contacts.body[first], self._contacts.body[second]
            if one == other:
                continue
            if self._contacts.chain.parents[other - 1] == one:
                found.append(Pair(first, second, True, "neighbours: they touch at their joint"))
            else:
                found.append(self._marked(self._judge(first, second)))
        return found

    def _marked(self, pair: Pair) -> Pair:
        """The same pair, `exact` if its covers block more than MOST_TAKEN of all configurations."""
        taken = 0.0 if pair.ignored else self._taken(pair)
        if taken <= MOST_TAKEN:
            return pair
        more = (
            f"; their covers also overlap in another {taken:.0%} of all configurations, so the search leaves them out"
        )
        return replace(pair, exact=True, reason=pair.reason + more)

    def _taken(self, pair: Pair) -> float:
        """The share of configurations in which the covers of two links overlap but their exact geometry does not."""
        covers = ((link, self._fitted[link].balls) for link in (pair.first, pair.second))
        near = np.flatnonzero(
            _gaps(*(_placed(balls, self._contacts.poses[link][:_CROWD]) for link, balls in covers)) < 0.0
        )
        return sum(not self._overlap(pair.first, pair.second, k) for k in near.tolist()) / _CROWD

    def _bounds(self, link: str) -> Array:
        """Balls (k, 4) around the primitives of a link."""
        return np.array([(*shape.pose[:3, 3], shape.radius) for shape in self._parts[link]])

    def _overlap(self, first: str, second: str, k: int) -> bool:
        """Whether the exact geometry of two links overlaps."""
        poses = [self._contacts.poses[link][k] for link in (first, second)]
        one, other = (
            _placed(self._bounds(link), pose[None])[0] for link, pose in zip((first, second), poses, strict=True)
        )
        apart = cdist(one[:, :3], other[:, :3]) - one[:, None, 3] - other[:, 3]
        return any(
            distance(a, poses[0] @ a.pose, b, poses[1] @ b.pose) <= 0.0
            for i, j in np.argwhere(apart < 0.0).tolist()
            for a, b in [(self._parts[first][i], self._parts[second][j])]
        )

    def _judge(self, first: str, second: str) -> Pair:
        gaps = _gaps(*(_placed(self._bounds(link), self._contacts.poses[link]) for link in (first, second)))
        near = np.flatnonzero(gaps < 0.0)
        if not len(near):
            return Pair(
                first, second, False, f"they came near in none of {SAMPLES} configurations; checking it costs nothing"
            )
        near = near[np.argsort(gaps[near])]
        bare = self._contacts.mixed(first, second)
        if self._always(first, second, near):
            if not bare or self._always(first, second, near, bare):
                return Pair(first, second, True, f"they touch in all of {SAMPLES} configurations")
            if any(self._contacts.touch(first, second, k, bare) for k in near.tolist()):
                return Pair(
                    first, second, False, "their collision geometry parts, though what is seen of them does not"
                )
            return self._never(first, second, near, "collision geometry", bare)
        if any(self._contacts.touch(first, second, k) for k in near.tolist()):
            return Pair(first, second, False, "their meshes can collide")
        return self._never(first, second, near, "meshes")

    def _always(self, first: str, second: str, near: NDArray[np.intp], bare: Sequence[str] = ()) -> bool:
        """Whether they touch in all configurations."""
        return len(near) == SAMPLES and all(self._contacts.touch(first, second, k, bare) for k in near[::-1].tolist())

    def _never(self, first: str, second: str, near: NDArray[np.intp], what: str, bare: Sequence[str] = ()) -> Pair:
        """The decision for two links that touched in no configuration."""
        least = self._nearest(first, second, near, bare)
        share = f"their {what} met in none of {SAMPLES} configurations (less than {300 / SAMPLES:.2g} % of all, with 95 % confidence)"
        travel = self._travel.get(first, 0.0) + self._travel.get(second, 0.0)
        if least > CLEAR + travel:
            return Pair(first, second, True, f"{share}, and come no nearer than {1e3 * least:.0f} mm")
        if least > 0.0 and not travel and all(self._overlap(first, second, k) for k in range(_CROWD)):
            contained = f"they come as near as {1e3 * least:.1f} mm, but what contains them always overlaps"
            return Pair(first, second, True, f"{share}; {contained}")
        return Pair(first, second, False, f"{share}, but come as near as {1e3 * least:.1f} mm")

    def _nearest(self, first: str, second: str, near: NDArray[np.intp], bare: Sequence[str]) -> float:
        """The smallest distance (m) found by walking from the samples whose covers overlap most."""
        rng = np.random.default_rng(1)
        lower, upper = self._contacts.lower, self._contacts.upper
        moves = np.arange(len(lower))
        between = (moves >= self._contacts.body[first]) & (moves < self._contacts.body[second])
        least = np.inf
        for k in near[:_SEARCHES]:
            q = self._contacts.q[k]
            best = self._contacts.distance(first, second, q, bare)
            width = 0.3
            for _ in range(_STEPS):
                tried = np.clip(q + between * rng.normal(scale=width, size=len(q)), lower, upper)
                found = self._contacts.distance(first, second, tried, bare)
                if found < best:
                    q, best = tried, found
                else:
                    width *= 0.93
            least = min(least, best)
        return least


def _gaps(one: Array, other: Array) -> Array:
    """Distances (n,) of balls (n, k, 4) and (n, l, 4), negative if they overlap."""
    return np.array(
        [(cdist(a[:, :3], b[:, :3]) - a[:, None, 3] - b[:, 3]).min() for a, b in zip(one, other, strict=True)]
    )


def _placed(balls: Array, poses: Array) -> Array:
    """Balls (k, 4) at poses (n, 4, 4), as (n, k, 4)."""
    centers = np.einsum("nij,kj->nki", poses[:, :3, :3], balls[:, :3]) + poses[:, None, :3, 3]
    return np.concatenate([centers, np.broadcast_to(balls[:, 3:], (*centers.shape[:2], 1))], axis=2)
