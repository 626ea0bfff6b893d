"""The checks of one robot among its obstacles, each with working memory of its own."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.kernels.clearance_search import Obstacles
from zarm_geometry.kernels.compiled import inlined, kernel
from zarm_geometry.kernels.first_contact import first_contact
from zarm_geometry.kernels.motion import MotionBody, Movers, Solids, motion
from zarm_geometry.kernels.nearby import GRADIENT, near
from zarm_trajectory.arrays import Array, Bits

Owner = NDArray[np.intp]

KEPT_MARGIN = GRADIENT
"""The column of a row of `nearby` with the largest margin (m) that a pair can keep."""
GRADIENT_THERE = KEPT_MARGIN + 1
"""The column in which the gradient starts in a row of `nearby`."""
MOST_PAIRS = 64
"""Most world rows and pairs of links distinguished near one configuration."""


class SituationArrays(NamedTuple):
    """A robot among obstacles: the shapes `standing` of the world, which are `checked` (n,) against the links of these bits, and the movers.

    `owner` (n,) and `mover_owner` (movers,) number the objects to which they belong.
    """

    body: MotionBody
    owner: Owner
    world: Obstacles
    standing: Solids
    checked: Bits
    movers: Movers
    mover_owner: Owner


@kernel
def contact(
    situation: SituationArrays, time: Array, q: Array, acceleration: Array, margin: float
) -> tuple[int, int, int]:
    """`first_contact` on the motion `q` (N, dof) at `time` (N,), N > 1, see `motion.motion`."""
    body = situation.body
    moved = motion(body, time, q, acceleration)
    return first_contact(body, situation.world, situation.standing, situation.checked, situation.movers, moved, margin)


@kernel
def nearby(situation: SituationArrays, q: Array, time: float, within: float) -> Array:
    """What is closer than `within` (m) at `q` (dof,) at a `time` (s), nearest first: each link and object, and each
    pair of links, once.

    The rows (n, 4 + dof) are those of `nearby.near` with the ROOM between its columns. If there are more than
    MOST_PAIRS, the nearest count.
    """
    body, dof = situation.body, q.shape[0]
    at, twice = np.empty(2), np.empty((2, dof))
    at[0], at[1], twice[0], twice[1] = time, time + 1.0, q, q
    standing = motion(body, at, twice, np.zeros(dof))
    found = np.empty((MOST_PAIRS, GRADIENT + dof))
    count = near(
        body, situation.world, situation.standing, situation.checked, situation.movers, standing, within, found
    )
    rows, kept = np.empty((count, GRADIENT_THERE + dof)), 0
    for k in np.argsort(found[:count, 0]):
        part, other = int(found[k, 1]), int(found[k, 2])
        link = _link_of(body, part)
        if _is_known(situation, rows, kept, link, other):
            continue
        rows[kept, :GRADIENT] = found[k, :GRADIENT]
        rows[kept, KEPT_MARGIN] = _kept_margin(body, link, other)
        rows[kept, GRADIENT_THERE:] = found[k, GRADIENT:]
        kept += 1
    return rows[:kept].copy()


@inlined
def _link_of(body: MotionBody, part: int) -> int:
    """The link to which a part belongs."""
    link = 0
    while body.first[link + 1] <= part:
        link += 1
    return link


@inlined
def _is_known(situation: SituationArrays, found: Array, count: int, link: int, other: int) -> bool:
    """Whether a row, among the first `count`, is of this link and of the object to which `other` belongs."""
    rows = situation.owner.shape[0]
    for k in range(count if other >= 0 else 0):  # a pair of links is found once
        before = int(found[k, 2])
        if before < 0 or (before < rows) != (other < rows) or _link_of(situation.body, int(found[k, 1])) != link:
            continue
        if other < rows and situation.owner[before] == situation.owner[other]:
            return True
        if other >= rows and situation.mover_owner[before - rows] == situation.mover_owner[other - rows]:
            return True
    return False


@inlined
def _kept_margin(body: MotionBody, link: int, other: int) -> float:
    """The largest margin (m) that a link can keep from `other`, see `first_contact`."""
    if other >= 0:
        return np.inf
    his, links = _link_of(body, -1 - other), body.first.shape[0] - 1
    for k in range(body.pairs.shape[0]):
        if body.pairs[k, 1] == link and body.pairs[k, 0] == his:
            return float(body.kept_margin[links + k])
    return np.inf
