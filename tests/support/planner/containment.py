"""Proof that one set of collision primitives contains another: not by sampling, but for every point of the volume."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from zarm_contract.collision import CollisionCapsule, CollisionPrimitive, CollisionSphere

CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)


def contains(cover: Sequence[CollisionPrimitive], inner: CollisionPrimitive, *, finest: float = 5e-5) -> bool:
    """Whether every point of `inner` lies inside some primitive of `cover`; False also if `finest` (m) is not fine
    enough to decide.

    The cube around `inner` is divided into eight repeatedly. A cell is finished once the ball around it lies outside
    `inner`, or inside one primitive of `cover`: signed distances change no faster than the point moves.
    """
    a, b, radius = _segment(inner)
    if any(max(_distance(one, np.stack((a, b)))) + radius <= 1e-9 for one in cover):
        return True  # both are convex: if its two end balls are inside, all of it is
    half = float(np.max(abs(a - b))) / 2 + radius
    centers = ((a + b) / 2)[None]
    while half > finest:
        around = half * np.sqrt(3)
        centers = centers[_distance(inner, centers) < around]
        outside = np.min([_distance(one, centers) for one in cover], axis=0)
        if np.any((outside > 0) & (_distance(inner, centers) < 0)):
            return False
        centers = centers[outside > -around]
        if not len(centers):
            return True
        half /= 2
        centers = (centers[:, None] + half * CORNERS).reshape(-1, 3)
    return False


def _distance(primitive: CollisionPrimitive, points: np.ndarray) -> np.ndarray:
    """Signed distances (n,) of points (n, 3) to the surface, negative inside."""
    a, b, radius = _segment(primitive)
    along = np.clip((points - a) @ (b - a) / max(float((b - a) @ (b - a)), 1e-30), 0, 1)
    return np.linalg.norm(points - a - along[:, None] * (b - a), axis=1) - radius


def _segment(primitive: CollisionPrimitive) -> tuple[np.ndarray, np.ndarray, float]:
    """A sphere or capsule as all points within a radius of a segment."""
    if isinstance(primitive, CollisionSphere):
        return np.array(primitive.center), np.array(primitive.center), primitive.radius
    if isinstance(primitive, CollisionCapsule):
        return np.array(primitive.a), np.array(primitive.b), primitive.radius
    raise TypeError(f"no distance to a {primitive.kind} here yet")
