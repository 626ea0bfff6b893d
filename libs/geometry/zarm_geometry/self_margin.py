"""The margin that each pair of links of the robot can keep."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.body import Body
from zarm_trajectory.arrays import Array

CONFIGURATIONS = 512
"""Number of random configurations in which distances are measured."""
LOST = 0.05
"""Share of the collision-free configurations that a margin may exclude, for each pair."""
_BELOW = 0.9
"""Share of the measured distance that can be kept: two adjacent links have the same distance everywhere, except for
rounding.
"""


def pair_room(bodies: Sequence[Body], frames: Array, pairs: NDArray[np.int32]) -> Array:
    """The distance (pairs,) in m that the spheres of each pair (pairs, 2) of `bodies` can be required to keep.

    All but a share `LOST` of the configurations in which they do not touch keep at least this; `frames`
    (configurations, bodies, 4, 4) are those of the bodies. 0 if they touch in all of them.
    """
    places = [
        np.einsum("nij,bj->nbi", frames[:, i, :3, :3], body.balls[:, :3]) + frames[:, i, None, :3, 3]
        for i, body in enumerate(bodies)
    ]
    return np.array([_room(places[i], bodies[i].balls[:, 3], places[j], bodies[j].balls[:, 3]) for i, j in pairs])


def _room(one: Array, radii: Array, other: Array, other_radii: Array) -> float:
    """The same for two sets of spheres with centres (configurations, n, 3) and radii (n,)."""
    gap = np.full(len(one), np.inf)
    for k, radius in enumerate(radii):
        apart = np.linalg.norm(other - one[:, k, None], axis=2) - other_radii - radius
        np.minimum(gap, apart.min(axis=1), out=gap)
    free = gap[gap > 0.0]
    return _BELOW * float(np.quantile(free, LOST)) if len(free) else 0.0
