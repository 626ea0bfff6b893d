"""Pairs of a link and an object that may touch, as bit masks for the kernels.

Each name that is in one of the pairs has a bit of its own, and the first bit is that of all other links. An obstacle is checked against
the links whose bit is in its mask. A link whose pairs are not known has the first bit, so it is checked against everything.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from zarm_contract.messages import VOXEL_MAP
from zarm_trajectory.arrays import Bits

Pairs = tuple[tuple[str, str], ...]

EVERY_LINK = ~np.uint64(0)
"""The mask of what is checked against all links."""


def link_bits(links: Sequence[str], pairs: Pairs) -> Bits:
    """The bit of each link, or attached object, (n,)."""
    bits = _bits(pairs)
    return np.array([bits.get(link, 1) for link in links], np.uint64)


def checked(objects: Sequence[str], pairs: Pairs) -> Bits:
    """For each object (n,) the bits of the links against which it is checked."""
    bits = _bits(pairs)
    left_out = dict.fromkeys(bits, 0)
    for one, other in (*pairs, *((b, a) for a, b in pairs)):
        left_out[one] |= bits[other]
    in_map = left_out.get(VOXEL_MAP, 0)
    masks = (left_out.get(name, 0) | (in_map if name.startswith(f"{VOXEL_MAP}.") else 0) for name in objects)
    return np.array([int(EVERY_LINK) & ~mask for mask in masks], np.uint64)


def partners(name: str, pairs: Pairs) -> frozenset[str]:
    """What a link or an object may touch by these pairs."""
    return frozenset(other for pair in pairs if name in pair for other in pair if other != name)


def _bits(pairs: Pairs) -> dict[str, int]:
    names = sorted({name for pair in pairs for name in pair})
    return {name: 2 << index for index, name in enumerate(names)}
