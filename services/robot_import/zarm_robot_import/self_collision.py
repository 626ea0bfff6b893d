"""Which pairs of links can meet, decided on the original meshes; a pair in doubt stays checked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import fcl
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from zarm_geometry.robot_model import RobotModel
from zarm_geometry.shapes import distance

Array = NDArray[np.float64]

SAMPLES = 4000
"""Configurations: of what none of them shows, less than 3/SAMPLES of all have it, with 95 % confidence."""
CLEAR = 0.005
"""Meshes that come no nearer than this (m) in samples and in a search from the nearest of them are taken never to meet."""
MOST_TAKEN = 0.3
"""Share of all configurations that covers may take from a pair of links before the search leaves it out."""
_CROWD = 300
"""Configurations in which the exact geometry is looked at."""
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
    """The links of a model, sampled all over its joint ranges."""

    def __init__(self, model: RobotModel, meshes: Mapping[str, Array]) -> None:
        self._model = model
        self._meshes = {link: _bvh(triangles) for link, triangles in meshes.items()}
        self._parts = [[shape for k, shape in model.parts if k == i] for i in range(len(model.links))]
        self.q = np.random.default_rng(0).uniform(model.lower, model.upper, (SAMPLES, model.dof))
        self._poses = model.link_transforms(self.q)

    def judged(self) -> list[Pair]:
        """Every pair of links on different bodies."""
        model = self._model
        found = []
        for (i, first), (j, second) in combinations(enumerate(model.links), 2):
            one, other = sorted((int(model.link_joint[i]), int(model.link_joint[j])))
            if one == other:
                continue
            if other == one + 1:
                found.append(Pair(first, second, True, "neighbours: they touch at their joint"))
            else:
                found.append(self._judge(i, j))
        return found

    def marked(self, pairs: Sequence[Pair], covers: Mapping[str, Array]) -> list[Pair]:
        """The same, with those `exact` whose covers (k, 4) take more than MOST_TAKEN of all configurations."""
        found = []
        for pair in pairs:
            taken = 0.0 if pair.ignored else self._taken(pair, covers)
            more = f"; their covers also overlap in another {taken:.0%} of all configurations, so the search leaves them out"
            found.append(replace(pair, exact=True, reason=pair.reason + more) if taken > MOST_TAKEN else pair)
        return found

    def _taken(self, pair: Pair, covers: Mapping[str, Array]) -> float:
        """The share of configurations in which the covers of two links overlap and their exact geometry does not."""
        poses = self._poses[:_CROWD]
        i, j = (self._model.links.index(link) for link in (pair.first, pair.second))
        near = np.flatnonzero(_gaps(*(_placed(covers[self._model.links[k]], poses[:, k]) for k in (i, j))) < 0.0)
        return sum(not self._overlap(i, j, poses[k]) for k in near) / _CROWD

    def _bounds(self, i: int) -> Array:
        """Balls (k, 4) around the primitives of a link."""
        return np.array([(*shape.pose[:3, 3], shape.radius) for shape in self._parts[i]])

    def _overlap(self, i: int, j: int, poses: Array) -> bool:
        """Whether the exact geometry of two links does."""
        balls = [_placed(self._bounds(k), poses[None, k])[0] for k in (i, j)]
        apart = cdist(balls[0][:, :3], balls[1][:, :3]) - balls[0][:, None, 3] - balls[1][:, 3]
        return any(
            distance(
                self._parts[i][a],
                poses[i] @ self._parts[i][a].pose,
                self._parts[j][b],
                poses[j] @ self._parts[j][b].pose,
            )
            <= 0.0
            for a, b in np.argwhere(apart < 0.0).tolist()
        )

    def _judge(self, i: int, j: int) -> Pair:
        first, second = self._model.links[i], self._model.links[j]
        gaps = _gaps(*(_placed(self._bounds(k), self._poses[:, k]) for k in (i, j)))
        near = np.flatnonzero(gaps < 0.0)
        if not len(near):
            return Pair(
                first, second, False, f"they came near in none of {SAMPLES} configurations; checking it costs nothing"
            )
        near = near[np.argsort(gaps[near])]
        touching = [self._touch(i, j, self._poses[k]) for k in (near if len(near) == SAMPLES else ())]
        if touching and all(touching):
            return Pair(first, second, True, f"they touch in all of {SAMPLES} configurations")
        if any(touching) or any(self._touch(i, j, self._poses[k]) for k in near):
            return Pair(first, second, False, "their meshes can collide")
        least = self._nearest(i, j, near)
        share = f"their meshes met in none of {SAMPLES} configurations (less than {300 / SAMPLES:.2g} % of all, with 95 % confidence)"
        if least > CLEAR:
            return Pair(first, second, True, f"{share}, and come no nearer than {1e3 * least:.0f} mm")
        if least > 0.0 and all(self._overlap(i, j, poses) for poses in self._poses[:_CROWD]):
            return Pair(
                first,
                second,
                True,
                f"{share}; they come as near as {1e3 * least:.1f} mm, but what contains them always overlaps",
            )
        return Pair(first, second, False, f"{share}, but come as near as {1e3 * max(least, 0.0):.1f} mm")

    def _touch(self, i: int, j: int, poses: Array) -> bool:
        return bool(fcl.collide(*self._objects(i, j, poses), fcl.CollisionRequest(), fcl.CollisionResult()))

    def _distance(self, i: int, j: int, q: Array) -> float:
        """Of the meshes (m), 0 where they touch."""
        poses = self._model.link_transforms(q)
        if self._touch(i, j, poses):
            return 0.0
        return max(0.0, float(fcl.distance(*self._objects(i, j, poses), fcl.DistanceRequest(), fcl.DistanceResult())))

    def _nearest(self, i: int, j: int, near: NDArray[np.intp]) -> float:
        """The smallest distance (m) found by walking from the samples whose covers overlap most."""
        rng = np.random.default_rng(1)
        model = self._model
        between = np.arange(model.dof) > min(model.link_joint[i], model.link_joint[j])
        between &= np.arange(model.dof) <= max(model.link_joint[i], model.link_joint[j])
        least = np.inf
        for k in near[:_SEARCHES]:
            q = self.q[k]
            best = self._distance(i, j, q)
            width = 0.3
            for _ in range(_STEPS):
                tried = np.clip(q + between * rng.normal(scale=width, size=model.dof), model.lower, model.upper)
                found = self._distance(i, j, tried)
                if found < best:
                    q, best = tried, found
                else:
                    width *= 0.93
            least = min(least, best)
        return least

    def _objects(self, i: int, j: int, poses: Array) -> list[Any]:
        return [
            fcl.CollisionObject(self._meshes[self._model.links[k]], fcl.Transform(poses[k, :3, :3], poses[k, :3, 3]))
            for k in (i, j)
        ]


def _gaps(one: Array, other: Array) -> Array:
    """Distances (n,) of balls (n, k, 4) and (n, l, 4), below 0 where they overlap."""
    return np.array(
        [(cdist(a[:, :3], b[:, :3]) - a[:, None, 3] - b[:, 3]).min() for a, b in zip(one, other, strict=True)]
    )


def _placed(balls: Array, poses: Array) -> Array:
    """Balls (k, 4) at poses (n, 4, 4), as (n, k, 4)."""
    centers = np.einsum("nij,kj->nki", poses[:, :3, :3], balls[:, :3]) + poses[:, None, :3, 3]
    return np.concatenate([centers, np.broadcast_to(balls[:, 3:], (*centers.shape[:2], 1))], axis=2)


def _bvh(triangles: Array) -> Any:
    mesh = fcl.BVHModel()
    mesh.beginModel(len(triangles), 3 * len(triangles))
    mesh.addSubModel(triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3))
    mesh.endModel()
    return mesh
