"""Which pairs of links can meet, decided on the original meshes; a pair in doubt stays checked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import fcl
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from zarm_geometry.robot_model import RobotModel
from zarm_robot_import.fitting import Fitted

Array = NDArray[np.float64]

SAMPLES = 4000
"""Configurations: of what none of them shows, less than 3/SAMPLES of all have it, with 95 % confidence."""
CLEAR = 0.005
"""Meshes that come no nearer than this (m) in samples and in a search from the nearest of them are taken never to meet."""
_SEARCHES = 3
_STEPS = 40


@dataclass(frozen=True)
class Pair:
    """Two links, whether they are left out of self-collision, and why or why not."""

    first: str
    second: str
    ignored: bool
    reason: str


class Pairs:
    """The links of a model, sampled all over its joint ranges."""

    def __init__(self, model: RobotModel, fitted: Sequence[Fitted], meshes: Mapping[str, Array]) -> None:
        self._model = model
        self._covers = {link.link: link.balls for link in fitted}
        self._meshes = {link: _bvh(triangles) for link, triangles in meshes.items()}
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

    def gaps(self, i: int, j: int, poses: Array) -> Array:
        """Distances (n,) of the covers of two links at link poses (n, links, 4, 4), below 0 where they overlap."""
        balls = [_placed(self._covers[self._model.links[k]], poses[:, k]) for k in (i, j)]
        found = np.empty(len(poses))
        for k in range(len(poses)):
            apart = cdist(balls[0][k, :, :3], balls[1][k, :, :3])
            found[k] = (apart - balls[0][k, :, 3:] - balls[1][k, :, 3]).min()
        return found

    def _judge(self, i: int, j: int) -> Pair:
        first, second = self._model.links[i], self._model.links[j]
        gaps = self.gaps(i, j, self._poses)
        near = np.flatnonzero(gaps < 0.0)
        if not len(near):
            return Pair(
                first, second, False, f"its covers met in none of {SAMPLES} configurations; checking it costs nothing"
            )
        near = near[np.argsort(gaps[near])]
        touching = [self._touch(i, j, self._poses[k]) for k in (near if len(near) == SAMPLES else ())]
        if touching and all(touching):
            return Pair(first, second, True, f"they touch in all of {SAMPLES} configurations")
        if any(touching) or any(self._touch(i, j, self._poses[k]) for k in near):
            part = len(near) / SAMPLES
            much = f"; their covers overlap in {part:.0%} of all configurations" if part > 0.2 else ""
            return Pair(first, second, False, f"their meshes can collide{much}")
        least = self._nearest(i, j, near)
        share = f"their meshes met in none of {SAMPLES} configurations (less than {300 / SAMPLES:.2g} % of all, with 95 % confidence)"
        if least > CLEAR:
            return Pair(first, second, True, f"{share}, and come no nearer than {1e3 * least:.0f} mm")
        if least > 0.0 and len(near) > 0.99 * SAMPLES:
            return Pair(
                first,
                second,
                True,
                f"{share}; they come as near as {1e3 * least:.1f} mm, but the covers always overlap",
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
