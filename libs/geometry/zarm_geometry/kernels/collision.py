"""Collision checks of the sphere model against itself and the world, for 16 configurations at once."""

from __future__ import annotations

from typing import Any

import numpy as np

from zarm_geometry.kernels.arrays import SHAPE, Pointer, Space
from zarm_geometry.kernels.compiled import inlined
from zarm_geometry.kernels.placing import place_joints, place_points
from zarm_geometry.kernels.simd import (
    LANES,
    Lanes,
    Mask,
    below,
    larger,
    load,
    lowest_bit,
    magnitude,
    root,
    smaller,
    splat,
    where_positive,
    without,
)

RESOLUTION = 0.01
"""The most (m) that a sphere centre moves between two neighbouring checked configurations of an edge, unless the
interval between them is proven free. So any configuration in between is at most half of this away from a checked one:
within the default margin of 0.005 m.
"""


Bits = Any
"""A bit mask of up to 64 spheres."""
_SPHERES = 64


@inlined
def squared_distance_in_plane(b: float, c: float, d: float, x: Lanes, y: Lanes) -> Lanes:
    """Squared distance of points to the triangle (0, 0), (b, 0), (c, d) in the same plane, with b and d > 0; 0 inside.

    Outside, it is the squared distance to the nearest edge.
    """
    zero, one = splat(0.0), splat(1.0)
    right, left = c - b, np.float32(1.0) / (c * c + d * d)
    down = np.float32(1.0) / (right * right + d * d)
    ex = x - smaller(larger(x, zero), splat(b))
    apart = ex * ex + y * y
    t = smaller(larger((c * x + d * y) * left, zero), one)
    ex, ey = x - c * t, y - d * t
    apart = smaller(apart, ex * ex + ey * ey)
    bx = x - b
    t = smaller(larger((right * bx + d * y) * down, zero), one)
    ex, ey = bx - right * t, y - d * t
    apart = smaller(apart, ex * ex + ey * ey)
    inside = smaller(y, smaller(d * x - c * y, right * y - d * bx))
    return where_positive(zero - inside, apart)


@inlined
def squared_distance(shape: Pointer, i: int, x: Lanes, y: Lanes, z: Lanes) -> Lanes:
    """Squared distance of points to the core of the obstacle whose row starts at `shape[i]`; 0 inside."""
    zero = splat(0.0)
    px = shape[i] * x + shape[i + 1] * y + shape[i + 2] * z + shape[i + 3]
    py = shape[i + 4] * x + shape[i + 5] * y + shape[i + 6] * z + shape[i + 7]
    pz = shape[i + 8] * x + shape[i + 9] * y + shape[i + 10] * z + shape[i + 11]
    if shape[i + 15] < 0.0:
        return squared_distance_in_plane(shape[i + 12], shape[i + 13], shape[i + 14], px, py) + pz * pz
    dx = larger(magnitude(px) - shape[i + 12], zero)
    dy = larger(magnitude(py) - shape[i + 13], zero)
    dz = larger(magnitude(pz) - shape[i + 14], zero)
    across = dx * dx + dy * dy
    if shape[i + 15] > 0.0:
        rim = larger(root(across) - shape[i + 15], zero)
        across = rim * rim
    return across + dz * dz


@inlined
def _slack(half: Lanes, motion: float) -> Lanes:
    """Upper bound (m) on how far a ball moves from the middle of each lane's interval; 0 where it is below half of
    RESOLUTION, so that the interval needs no further subdivision.

    `half` is half the length of the intervals, `motion` (m) bounds the ball's motion along the whole edge.
    """
    slack = half * motion
    return where_positive(slack - 0.5 * RESOLUTION, slack)


@inlined
def in_box(boxes: Pointer, node: int, x: Lanes, y: Lanes, z: Lanes, reach: Lanes) -> Mask:
    """The lanes in which a point is within `reach` (m) of the box of a node."""
    zero = splat(0.0)
    box = 6 * node
    dx = larger(magnitude(x - boxes[box]) - boxes[box + 3], zero)
    dy = larger(magnitude(y - boxes[box + 1]) - boxes[box + 4], zero)
    dz = larger(magnitude(z - boxes[box + 2]) - boxes[box + 5], zero)
    return below(dx * dx + dy * dy + dz * dz, reach * reach)


@inlined
def _reached(space: Space, first: int, active: Bits, node: int, half: Lanes) -> Bits:
    """The subset of the `active` spheres, numbered from `first`, that come near the box of a node in any lane."""
    reached = np.uint64(0)
    while active != 0:
        bit = active & (~active + np.uint64(1))
        active ^= bit
        sphere = first + lowest_bit(bit)
        ball = space.links + sphere
        at = ball * 3 * LANES
        x, y, z = load(space.centers, at), load(space.centers, at + LANES), load(space.centers, at + 2 * LANES)
        reach = _slack(half, space.motion[ball]) + (space.spheres[4 * sphere + 3] + space.margin)
        if in_box(space.boxes, node, x, y, z, reach) != 0:
            reached |= bit
    return reached


@inlined
def _place_balls(space: Space, link: int) -> None:
    """Place a link's spheres, unless they are."""
    if space.placed[link] == 0:
        space.placed[link] = 1
        first, last = space.link_first[link], space.link_first[link + 1]
        place_points(space.frames, space.link_joint[link], space.spheres, 4, first, last, space.centers, space.links)


@inlined
def meets_world(space: Space, link: int, half: Lanes) -> tuple[Mask, Mask]:
    """The lanes in which a link touches an obstacle (only those of the first contact found), and the lanes in which it
    is so near to one that the interval is not proven free.

    Only the spheres that come near a node's box descend into it.
    """
    zero = splat(0.0)
    at = link * 3 * LANES
    x, y, z = load(space.centers, at), load(space.centers, at + LANES), load(space.centers, at + 2 * LANES)
    around = space.bounds[4 * link + 3] + space.margin
    near = np.uint32(0)
    for first in range(space.link_first[link], space.link_first[link + 1], _SPHERES):
        count = min(space.link_first[link + 1] - first, _SPHERES)
        space.active[0] = ~np.uint64(0) >> np.uint64(_SPHERES - count)
        space.until[0] = space.nodes
        level, node = 0, 0
        while node < space.nodes:
            while node >= space.until[level]:
                level -= 1
            active = space.active[level]
            several = active & (active - np.uint64(1)) != 0
            if several and in_box(space.boxes, node, x, y, z, _slack(half, space.motion[link]) + around) == 0:
                node = space.skip[node]
                continue
            _place_balls(space, link)
            row = space.leaf[node]
            if row < 0:
                active = _reached(space, first, active, node, half)
                if active == 0:
                    node = space.skip[node]
                    continue
                node += 1
                level += 1
                space.active[level] = active
                space.until[level] = space.skip[node - 1]
                continue
            node += 1
            if space.checked[row] & space.bit[link] == 0:
                continue
            shape = SHAPE * row
            rounding = space.shapes[shape + 16] + space.margin
            found = near
            while active != 0:
                sphere = first + lowest_bit(active)
                active &= active - np.uint64(1)
                ball = space.links + sphere
                at = ball * 3 * LANES
                bx, by, bz = (
                    load(space.centers, at),
                    load(space.centers, at + LANES),
                    load(space.centers, at + 2 * LANES),
                )
                slack = _slack(half, space.motion[ball])
                apart = squared_distance(space.shapes, shape, bx, by, bz)
                radius = space.spheres[4 * sphere + 3] + rounding
                reach = slack + radius
                close = below(apart, reach * reach)
                if close != 0:
                    near |= close & below(zero, slack)
                    hit = below(apart, splat(radius * radius))
                    if hit != 0:
                        return hit, near
            if near != found:  # these intervals will be subdivided anyway: from now on only their contacts matter
                half = without(near, half)
    return np.uint32(0), near


@inlined
def meet(space: Space, pair: int, half: Lanes) -> tuple[Mask, Mask]:
    """The lanes in which two links come too close to each other (only those of the first contact found), and the lanes
    in which they are so close that the interval is not proven free.
    """
    zero, near = splat(0.0), np.uint32(0)
    a, b, kept = space.pair[2 * pair], space.pair[2 * pair + 1], space.apart[pair]
    motion = (space.common[pair] + 1) * space.balls  # the joints up to the common one move both links together
    i = a * 3 * LANES
    ax, ay, az = load(space.centers, i), load(space.centers, i + LANES), load(space.centers, i + 2 * LANES)
    j = b * 3 * LANES
    bx, by, bz = load(space.centers, j), load(space.centers, j + LANES), load(space.centers, j + 2 * LANES)
    x, y, z = ax - bx, ay - by, az - bz
    wide = _slack(half, space.motion[motion + a] + space.motion[motion + b]) + (space.bounds[4 * b + 3] + kept)
    reach = wide + space.bounds[4 * a + 3]
    if below(x * x + y * y + z * z, reach * reach) == 0:
        return near, near
    _place_balls(space, a)
    _place_balls(space, b)
    for first in range(space.link_first[a], space.link_first[a + 1]):
        i = (space.links + first) * 3 * LANES
        ax, ay, az = load(space.centers, i), load(space.centers, i + LANES), load(space.centers, i + 2 * LANES)
        x, y, z = ax - bx, ay - by, az - bz
        reach = wide + space.spheres[4 * first + 3]
        if below(x * x + y * y + z * z, reach * reach) == 0:
            continue
        own = space.motion[motion + space.links + first]
        for second in range(space.link_first[b], space.link_first[b + 1]):
            ball = space.links + second
            j = ball * 3 * LANES
            x = ax - load(space.centers, j)
            y = ay - load(space.centers, j + LANES)
            z = az - load(space.centers, j + 2 * LANES)
            apart = x * x + y * y + z * z
            radii = space.spheres[4 * first + 3] + space.spheres[4 * second + 3] + kept
            slack = _slack(half, own + space.motion[motion + ball])
            reach = slack + radii
            close = below(apart, reach * reach)
            if close != 0:
                near |= close & below(zero, slack)
                hit = below(apart, splat(radii * radii))
                if hit != 0:
                    return hit, near
    return np.uint32(0), near


@inlined
def check(space: Space, whole: bool) -> tuple[Mask, Mask]:
    """Check the configurations in `Space.joints`, each for its interval of a motion, with `Space.half` of its length.

    Returns two masks: the lanes that collide, and the lanes in which something is so near that the interval is not
    proven free and must be subdivided. The check ends at the first contact found, so only an empty first mask is a
    statement about all lanes. If the intervals are the `whole` motion, what is near in none of them is not looked at
    again: only what is `watched`.
    """
    half, near = load(space.half, 0), np.uint32(0)
    place_joints(space.dof, space.tree, space.origin, space.joints, space.frames)
    for link in range(space.links - 1, -1, -1):  # outer links hit obstacles more often
        space.placed[link] = 0
        place_points(space.frames, space.link_joint[link], space.bounds, 4, link, link + 1, space.centers, 0)
        if space.link_joint[link] >= 0 and (whole or space.watched[link] != 0):
            hit, close = meets_world(space, link, half)
            if hit != 0:
                return hit, near
            near |= close
            if whole:
                space.watched[link] = close != 0
            else:
                half = without(near, half)
    for pair in range(space.pairs):
        if whole or space.watched[space.links + pair] != 0:
            hit, close = meet(space, pair, half)
            if hit != 0:
                return hit, near
            near |= close
            if whole:
                space.watched[space.links + pair] = close != 0
            else:
                half = without(near, half)
    return np.uint32(0), near
