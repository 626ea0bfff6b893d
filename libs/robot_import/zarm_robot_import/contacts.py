"""Whether the meshes of two links touch at configurations sampled from the joint ranges."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import fcl
import numpy as np

from zarm_robot_import.chain import Chain
from zarm_robot_import.limits import JointLimits
from zarm_robot_import.meshes import Surface
from zarm_trajectory.arrays import Array

SAMPLES = 4000
"""Number of configurations: what none of them shows occurs in less than 3/SAMPLES of all, with 95 % confidence."""


class Contacts:
    """The meshes of an arm at SAMPLES configurations `q` (SAMPLES, dof), where each link has `poses` (SAMPLES, 4, 4)."""

    def __init__(self, chain: Chain, limits: Sequence[JointLimits], surfaces: Sequence[Surface]) -> None:
        self.chain = chain
        lower, upper = np.array([(limit.lower, limit.upper) for limit in limits]).T
        # One turn of a joint that turns freely.
        self.lower, self.upper = np.where(np.isinf(lower), -np.pi, lower), np.where(np.isinf(upper), np.pi, upper)
        self.q = np.random.default_rng(0).uniform(self.lower, self.upper, (SAMPLES, len(limits)))
        self.poses = chain.poses(self.q)
        self.body = {mounted.link: mounted.body for mounted in chain.mounted}
        self._whole = {surface.link: mesh_object(surface.triangles) for surface in surfaces}
        self._collision = {
            surface.link: mesh_object(surface.shells["collision"]) for surface in surfaces if surface.kind == "both"
        }

    def drop_visual(self, link: str) -> None:
        """From now on represent a link by its collision geometry alone."""
        self._whole[link] = self._collision.pop(link)

    def mixed(self, *links: str) -> list[str]:
        """Those whose visual meshes are used beside their collision geometry."""
        return [link for link in links if link in self._collision]

    def touch(self, first: str, second: str, k: int, bare: Sequence[str] = ()) -> bool:
        """Whether two links touch at configuration `k`; those in `bare` with their collision geometry alone."""
        return self._touch(
            self._placed(first, self.poses[first][k], bare), self._placed(second, self.poses[second][k], bare)
        )

    def share(self, first: str, second: str, count: int, bare: Sequence[str] = ()) -> float:
        """The share of the first `count` configurations at which they do."""
        return sum(self.touch(first, second, k, bare) for k in range(count)) / count

    def distance(self, first: str, second: str, q: Array, bare: Sequence[str] = ()) -> float:
        """The distance (m) of two links at joints (dof,); 0 if they touch."""
        poses = self.chain.poses(q[None])
        one, other = (self._placed(link, poses[link][0], bare) for link in (first, second))
        if self._touch(one, other):
            return 0.0
        return max(0.0, float(fcl.distance(one, other, fcl.DistanceRequest(), fcl.DistanceResult())))

    def _touch(self, one: Any, other: Any) -> bool:
        return bool(fcl.collide(one, other, fcl.CollisionRequest(), fcl.CollisionResult()))

    def _placed(self, link: str, pose: Array, bare: Sequence[str]) -> Any:
        placed = self._collision[link] if link in bare and link in self._collision else self._whole[link]
        placed.setTransform(fcl.Transform(pose[:3, :3], pose[:3, 3]))
        return placed


def mesh_object(triangles: Array) -> Any:
    """Triangles (n, 3, 3) for FCL."""
    mesh = fcl.BVHModel()
    mesh.beginModel(len(triangles), 3 * len(triangles))
    mesh.addSubModel(triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3))
    mesh.endModel()
    return fcl.CollisionObject(mesh)
