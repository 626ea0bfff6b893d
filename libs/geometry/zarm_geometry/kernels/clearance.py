"""The smallest distance of the robot's exact shapes to the world and to each other along a motion, by branch and bound.

During an interval of the motion, two bodies never come closer than their distance at its middle sample minus how far
they travel from there (Schwarzer, Saha and Latombe, "Adaptive dynamic collision checking for single and multiple
articulated robots in complex environments", 2005). The search always examines the interval with the smallest lower
bound next. The distance at its middle may lower the smallest distance found so far, and the interval is split there.
Once no interval left can contain a smaller distance, the result is proven.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.kernels.broad_phase import MIN_SAMPLES, Cover, make_batch, push_near
from zarm_geometry.kernels.clearance_search import (
    COUNT,
    FIRST,
    ClearanceSearch,
    Obstacles,
    RobotParts,
    drop_top,
    place,
    push,
)
from zarm_geometry.kernels.compiled import inlined, kernel
from zarm_geometry.kernels.convex import PRECISION, Extents, Turn, Vector, core_distance, core_gap, turned, turned_back
from zarm_geometry.kernels.simd import lowest_bit
from zarm_trajectory.arrays import Array, Single

Stretch = tuple[int, int, int, int]
"""An interval of a motion: its first, middle and last sample, and the slot of the middle one in the course."""
Kept = tuple[float, float]
"""Two bounds (m), for the part of an interval before its middle sample and for the part after it."""


ROUGH = 0.2
"""Lower bounds that only decide which boxes to enter, and never the result, may be too small by this fraction."""
_PARTS_PER_DESCENT = 64
"""Parts of a link that descend the tree together."""


@inlined
def _arm(search: ClearanceSearch, slot: int, joint: int, x: float, y: float, z: float) -> float:
    """Distance (m) of a point from the axis of a joint at the sample in a slot."""
    a = search.axes
    dx, dy, dz = x - a[slot, joint, 3], y - a[slot, joint, 4], z - a[slot, joint, 5]
    along = dx * a[slot, joint, 0] + dy * a[slot, joint, 1] + dz * a[slot, joint, 2]
    return math.sqrt(max(dx * dx + dy * dy + dz * dz - along * along, 0.0))


@inlined
def _travel(
    body: RobotParts, search: ClearanceSearch, subject: int, stretch: Stretch, x: float, y: float, z: float, core: float
) -> Kept:
    """Upper bounds (m) on how far the points within `core` (m) of a point of a subject move from the first sample of an
    interval to its middle, and from there to the last. At the middle the point is at x, y, z (base frame).

    A joint moves them by at most its rotation times their distance from its axis. Joints further out may increase that
    distance by as much as they move the points, but it never exceeds `RobotParts.reach`.
    """
    low, k, high, slot = stretch
    moved = search.moved
    before, after = 0.0, 0.0
    for at in range(FIRST, FIRST + body.paths[subject, COUNT]):
        joint = body.paths[subject, at]
        reach = body.reach[subject, joint]
        earlier, later = reach, reach
        if body.tree[joint, 1] != 0:
            arm = _arm(search, slot, joint, x, y, z) + core
            earlier, later = min(reach, arm + before), min(reach, arm + after)
        before += earlier * (moved[k, joint] - moved[low, joint])
        after += later * (moved[high, joint] - moved[k, joint])
    return before, after


@inlined
def _rate(
    body: RobotParts, search: ClearanceSearch, stretch: Stretch, subject: int, i: int, first: int, last: int, step: int
) -> None:
    """Write to `search.rates` upper bounds on how far each joint from `first` to `last` in the path of a subject moves a
    part, in m/rad (1 for prismatic joints), before and after the middle of an interval.

    The loop starts at the joint next to the part: the joints already visited may carry the part further away from the
    axis of the next one.
    """
    low, k, high, slot = stretch
    rates, moved = search.rates, search.moved
    core = body.extents[i, 5] - body.extents[i, 4]
    x, y, z = search.centers[i, 0], search.centers[i, 1], search.centers[i, 2]
    before, after = 0.0, 0.0
    for at in range(first, last + step, step):
        joint = body.paths[subject, at]
        earlier, later = 1.0, 1.0
        if body.tree[joint, 1] != 0:
            arm = _arm(search, slot, joint, x, y, z) + core
            earlier, later = arm + before, arm + after
        rates[i, joint, 0], rates[i, joint, 1] = earlier, later
        before += earlier * (moved[k, joint] - moved[low, joint])
        after += later * (moved[high, joint] - moved[k, joint])


@inlined
def _at(frames: Array, slot: int, link: int, x: float, y: float, z: float) -> Vector:
    """A point, given in a link's frame, in the base frame at the sample in a slot."""
    return (
        frames[slot, link, 0, 0] * x
        + frames[slot, link, 0, 1] * y
        + frames[slot, link, 0, 2] * z
        + frames[slot, link, 0, 3],
        frames[slot, link, 1, 0] * x
        + frames[slot, link, 1, 1] * y
        + frames[slot, link, 1, 2] * z
        + frames[slot, link, 1, 3],
        frames[slot, link, 2, 0] * x
        + frames[slot, link, 2, 1] * y
        + frames[slot, link, 2, 2] * z
        + frames[slot, link, 2, 3],
    )


@inlined
def _place_parts(body: RobotParts, search: ClearanceSearch, slot: int, link: int) -> None:
    """Compute the centres of a link's parts in the base frame at the sample in a slot."""
    for i in range(body.first[link], body.first[link + 1]):
        x, y, z = _at(search.frames, slot, link, body.pose[i, 0, 3], body.pose[i, 1, 3], body.pose[i, 2, 3])
        search.centers[i, 0], search.centers[i, 1], search.centers[i, 2] = x, y, z


@inlined
def _part_turn(body: RobotParts, search: ClearanceSearch, slot: int, link: int, i: int) -> Turn:
    """The axes of a part in the base frame at the sample in a slot."""
    f = search.frames
    turn = (
        f[slot, link, 0, 0], f[slot, link, 0, 1], f[slot, link, 0, 2],
        f[slot, link, 1, 0], f[slot, link, 1, 1], f[slot, link, 1, 2],
        f[slot, link, 2, 0], f[slot, link, 2, 1], f[slot, link, 2, 2],
    )  # fmt: skip
    p = body.pose
    x = turned(turn, (p[i, 0, 0], p[i, 1, 0], p[i, 2, 0]))
    y = turned(turn, (p[i, 0, 1], p[i, 1, 1], p[i, 2, 1]))
    z = turned(turn, (p[i, 0, 2], p[i, 1, 2], p[i, 2, 2]))
    return x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2]


@inlined
def _core(table: Array, i: int, at: int) -> Extents:
    return table[i, at], table[i, at + 1], table[i, at + 2], table[i, at + 3]


@inlined
def _note(found: Array, lower: float, upper: float, part: int, other: int, k: int, best: float) -> tuple[Array, float]:
    """Append a pair to `found` if it collides or may have the smallest distance; rows start at 1 and `found[0, 0]`
    counts them.

    Returns `found`, moved to a larger array when full, and the smallest upper bound so far.
    """
    if not (upper < best or upper <= 0.0 or lower < best - PRECISION):
        return found, best
    count = int(found[0, 0]) + 1
    if count == found.shape[0]:
        larger = np.empty((2 * count, 5))
        for i in range(count):
            for c in range(5):
                larger[i, c] = found[i, c]
        found = larger
    found[0, 0] = count
    found[count, 0], found[count, 1] = lower, upper
    found[count, 2], found[count, 3], found[count, 4] = part, other, k
    return found, min(best, upper)


@inlined
def _box_distance(world: Obstacles, node: int, x: float, y: float, z: float) -> float:
    """Squared distance of a point to the box of a node."""
    b = world.boxes
    dx = max(abs(x - b[node, 0]) - b[node, 3] - world.slack, 0.0)
    dy = max(abs(y - b[node, 1]) - b[node, 4] - world.slack, 0.0)
    dz = max(abs(z - b[node, 2]) - b[node, 5] - world.slack, 0.0)
    apart: float = dx * dx + dy * dy + dz * dz
    return apart


@inlined
def _closest_row(world: Obstacles, x: float, y: float, z: float, within: float) -> int:
    """An obstacle near a point, found by descending to the nearest box on each level; -1 if the whole tree is at least
    `within` (m) away.
    """
    child, end, enough = 0, world.boxes.shape[0], within * within
    while True:
        node, nearest = -1, enough
        while child < end:
            apart = _box_distance(world, child, x, y, z)
            if apart < nearest:
                node, nearest = child, apart
            child = world.skip[child]
        if node < 0 or world.leaf[node] >= 0:
            return -1 if node < 0 else int(world.leaf[node])
        child, end, enough = node + 1, world.skip[node], math.inf


@inlined
def _to_row(
    body: RobotParts, world: Obstacles, search: ClearanceSearch, link: int, slot: int, i: int, row: int, limit: float
) -> tuple[float, float]:
    """Lower and upper bound (m) on the distance of a part to an obstacle. Once the lower one reaches `limit` (m) it
    need not be tight, and the upper one may be infinite.
    """
    r = world.rows
    core, rounding = _core(r, row, 12), r[row, 16]
    turn = (
        r[row, 0], r[row, 1], r[row, 2], r[row, 4], r[row, 5], r[row, 6], r[row, 8], r[row, 9], r[row, 10],
    )  # fmt: skip
    x, y, z = turned(turn, (search.centers[i, 0], search.centers[i, 1], search.centers[i, 2]))
    center = (x + r[row, 3], y + r[row, 7], z + r[row, 11])
    apart = core_distance(center, core)
    least: float = apart - rounding - body.extents[i, 5]
    if least >= limit:
        return least, math.inf
    if body.extents[i, 4] == body.extents[i, 5] and apart > 0.0:
        return least, least
    own = _part_turn(body, search, slot, link, i)
    u = turned(turn, (own[0], own[3], own[6]))
    v = turned(turn, (own[1], own[4], own[7]))
    w = turned(turn, (own[2], own[5], own[8]))
    own = (u[0], v[0], w[0], u[1], v[1], w[1], u[2], v[2], w[2])
    rounded = rounding + body.extents[i, 4]
    lower, upper, _, _ = core_gap(center, own, _core(body.extents, i, 0), core, limit + rounded)
    return lower - rounded, upper - rounded


@inlined
def _to_box(
    body: RobotParts, world: Obstacles, search: ClearanceSearch, link: int, slot: int, i: int, node: int, limit: float
) -> float:
    """A lower bound (m) on the distance of a part to the box of a node; below `limit` (m) it is exact for balls only."""
    b = world.boxes
    half = (b[node, 3] + world.slack, b[node, 4] + world.slack, b[node, 5] + world.slack, 0.0)
    center = (
        search.centers[i, 0] - b[node, 0],
        search.centers[i, 1] - b[node, 1],
        search.centers[i, 2] - b[node, 2],
    )
    apart: float = core_distance(center, half) - body.extents[i, 5]
    if apart >= limit or body.extents[i, 4] == body.extents[i, 5]:
        return apart
    rounding = body.extents[i, 4]
    lower, _, _, _ = core_gap(
        center, _part_turn(body, search, slot, link, i), _core(body.extents, i, 0), half, limit + rounding
    )
    kept: float = max(apart, lower - rounding)
    return kept


@inlined
def _to_world(
    body: RobotParts,
    world: Obstacles,
    search: ClearanceSearch,
    found: Array,
    link: int,
    k: int,
    slot: int,
    enough: float,
    best: float,
) -> tuple[float, Array, float]:
    """A lower bound (m), at most `enough`, on the distance of a link to the world; pairs that may be closer than `best`
    are appended to `found`.

    The obstacle near the link's centre is examined first, so that its distance prunes most of the tree. Only the parts
    that come near a node's box descend into it. Distances above `best` need not be exact: boxes that could reduce the
    smallest lower bound by no more than the fraction ROUGH are not entered.
    """
    lowest = nearest = enough
    a = body.around
    cx, cy, cz = _at(search.frames, slot, link, a[link, 0], a[link, 1], a[link, 2])
    closest = _closest_row(world, cx, cy, cz, max(best, enough, 0.0) + a[link, 3])
    if closest < 0:
        return lowest, found, best
    _place_parts(body, search, slot, link)
    if world.checked[closest] & body.bit[link] != 0:
        for i in range(body.first[link], body.first[link + 1]):
            lower, upper = _to_row(body, world, search, link, slot, i, closest, max(best, nearest, 0.0))
            nearest = min(nearest, lower)
            found, best = _note(found, lower, upper, i, closest, k, best)
    lowest = nearest
    nodes = world.boxes.shape[0]
    for first in range(body.first[link], body.first[link + 1], _PARTS_PER_DESCENT):
        count = min(body.first[link + 1] - first, _PARTS_PER_DESCENT)
        search.active[0] = ~np.uint64(0) >> np.uint64(_PARTS_PER_DESCENT - count)
        search.until[0] = nodes
        level, node = 0, 0
        while node < nodes:
            while node >= search.until[level]:
                level -= 1
            limit = max(best, (1.0 - ROUGH) * nearest, 0.0)
            apart = _box_distance(world, node, cx, cy, cz)
            wide = limit + a[link, 3]
            if apart >= wide * wide:
                wide = lowest + a[link, 3]
                if apart < wide * wide:
                    lowest = math.sqrt(apart) - a[link, 3]
                node = world.skip[node]
                continue
            active, near = search.active[level], np.uint64(0)
            while active != 0:
                i = first + lowest_bit(active)
                bit = active & (~active + np.uint64(1))
                active ^= bit
                apart = _to_box(body, world, search, link, slot, i, node, limit)
                if apart < limit:
                    near |= bit
                else:
                    lowest = min(lowest, apart)
            if near == 0:
                node = world.skip[node]
                continue
            row = world.leaf[node]
            node += 1
            if row < 0:
                level += 1
                search.active[level], search.until[level] = near, world.skip[node - 1]
                continue
            if row == closest or world.checked[row] & body.bit[link] == 0:
                continue
            while near != 0:
                i = first + lowest_bit(near)
                near &= near - np.uint64(1)
                lower, upper = _to_row(body, world, search, link, slot, i, row, max(best, nearest, 0.0))
                nearest = min(nearest, lower)
                found, best = _note(found, lower, upper, i, row, k, best)
        lowest = min(lowest, nearest)
    return lowest, found, best


@inlined
def _to_each_other(
    body: RobotParts,
    search: ClearanceSearch,
    found: Array,
    subject: int,
    one: int,
    other: int,
    stretch: Stretch,
    travel: Kept,
    best: float,
) -> tuple[Kept, Array, float]:
    """Lower bounds (m) on the distance of the two links of a subject before and after the middle of an interval. `one` is
    the outer link; pairs that may be closer than `best` are appended to `found`, where a part of `other` is -1 minus its index.

    A joint brings two points closer by at most its rotation times the smaller of their distances from its axis.
    """
    low, k, high, slot = stretch
    before = after = max(best, 0.0)
    a = body.around
    ax, ay, az = _at(search.frames, slot, one, a[one, 0], a[one, 1], a[one, 2])
    bx, by, bz = _at(search.frames, slot, other, a[other, 0], a[other, 1], a[other, 2])
    apart = math.sqrt((ax - bx) ** 2 + (ay - by) ** 2 + (az - bz) ** 2) - a[one, 3] - a[other, 3]
    if apart >= before + max(travel[0], travel[1]):
        return (before, after), found, best
    _place_parts(body, search, slot, one)
    _place_parts(body, search, slot, other)
    outer, inner = FIRST, FIRST + body.paths[subject, COUNT] - 1
    for j in range(body.first[other], body.first[other + 1]):
        _rate(body, search, stretch, subject, j, inner, outer, -1)
    rates, moved = search.rates, search.moved
    p = search.centers
    for i in range(body.first[one], body.first[one + 1]):
        reach = body.extents[i, 5] + a[other, 3]
        apart = math.sqrt((p[i, 0] - bx) ** 2 + (p[i, 1] - by) ** 2 + (p[i, 2] - bz) ** 2)
        if apart - reach >= max(best, before + travel[0], after + travel[1], 0.0):
            continue
        _rate(body, search, stretch, subject, i, outer, inner, 1)
        for j in range(body.first[other], body.first[other + 1]):
            own_before, own_after = 0.0, 0.0
            for at in range(outer, inner + 1):
                joint = body.paths[subject, at]
                own_before += min(rates[i, joint, 0], rates[j, joint, 0]) * (moved[k, joint] - moved[low, joint])
                own_after += min(rates[i, joint, 1], rates[j, joint, 1]) * (moved[high, joint] - moved[k, joint])
            limit = max(best, before + own_before, after + own_after, 0.0)
            x, y, z = p[i, 0] - p[j, 0], p[i, 1] - p[j, 1], p[i, 2] - p[j, 2]
            apart = math.sqrt(x * x + y * y + z * z)
            reach = body.extents[i, 5] + body.extents[j, 5]
            if apart - reach >= limit:
                continue
            rounded = body.extents[i, 4] + body.extents[j, 4]
            if rounded == reach:
                lower = upper = apart - reach
            else:
                turn = _part_turn(body, search, slot, other, j)
                own = _part_turn(body, search, slot, one, i)
                u = turned_back(turn, (own[0], own[3], own[6]))
                v = turned_back(turn, (own[1], own[4], own[7]))
                w = turned_back(turn, (own[2], own[5], own[8]))
                own = (u[0], v[0], w[0], u[1], v[1], w[1], u[2], v[2], w[2])
                center = turned_back(turn, (x, y, z))
                lower, upper, _, _ = core_gap(
                    center, own, _core(body.extents, i, 0), _core(body.extents, j, 0), limit + rounded
                )
                lower, upper = lower - rounded, upper - rounded
            before, after = min(before, lower - own_before), min(after, lower - own_after)
            found, best = _note(found, lower, upper, i, -1 - j, k, best)
    return (before, after), found, best


@inlined
def _look_at(
    body: RobotParts,
    world: Obstacles,
    search: ClearanceSearch,
    found: Array,
    subject: int,
    low: int,
    high: int,
    best: float,
) -> tuple[Kept, Kept, Array, float]:
    """Examine the middle sample of an interval of a subject. Returns lower bounds (m) on the distances before and after
    it, how far (m) the subject moves there, `found` with the pairs that may be closer than `best`, and the smallest
    upper bound so far.
    """
    links = body.offset.shape[0]
    k = (low + high) // 2
    slot = place(body, search, k)
    stretch = low, k, high - 1, slot
    one = subject if subject < links else int(body.pairs[subject - links, 1])
    x, y, z = _at(search.frames, slot, one, body.around[one, 0], body.around[one, 1], body.around[one, 2])
    travel = _travel(body, search, subject, stretch, x, y, z, body.spread[one])
    if subject < links:
        enough = max(best, 0.0) + max(travel[0], travel[1])
        lowest, found, best = _to_world(body, world, search, found, one, k, slot, enough, best)
        return (lowest - travel[0], lowest - travel[1]), travel, found, best
    other = body.pairs[subject - links, 0]
    kept, found, best = _to_each_other(body, search, found, subject, one, other, stretch, travel, best)
    return kept, travel, found, best


@kernel
def begin(
    body: RobotParts,
    cover: Cover,
    world: Obstacles,
    shapes: Single,
    search: ClearanceSearch,
    asked: NDArray[np.bool_],
    best: float,
) -> tuple[Array, float]:
    """Prepare the search along a course for distances below `best` (m): its intervals are those in which the subjects
    that are `asked` may come that close, or closer than they are at both ends of the motion.

    Returns pairs and the smallest upper bound as `look` does. `shapes` as in `push_near`.
    """
    samples = search.q.shape[0]
    found = np.empty((64, 5))
    found[0, 0] = 0.0
    if samples < MIN_SAMPLES:
        for subject in range(asked.shape[0]):
            if asked[subject]:
                push(search, -np.inf, subject, 0, samples)
        return found[1:1], best
    for end in (0, samples - 1):
        for subject in range(asked.shape[0]):
            if asked[subject]:
                _, _, found, best = _look_at(body, world, search, found, subject, end, end + 1, best)
    if best > 0.0:
        push_near(body, cover, world, shapes, search, asked, best, make_batch(cover))
    return found[1 : int(found[0, 0]) + 1], best


@kernel
def look(
    body: RobotParts, world: Obstacles, search: ClearanceSearch, best: float, most: int
) -> tuple[Array, float, bool]:
    """Examine up to `most` intervals in search of distances below `best` (m).

    Returns the pairs that may have the smallest distance, as rows of lower and upper bound (m), part, row of the world
    (or -1 minus another part), sample; the smallest upper bound so far; and whether the search is complete. If it is,
    no distance of any two shapes at any sample is more than PRECISION smaller than the smallest in these rows. A
    negative lower bound is minus an upper bound on the penetration depth. At a single sample all collisions are found;
    along a motion the search ends at the first.
    """
    found = np.empty((64, 5))
    found[0, 0] = 0.0
    over = False
    for _ in range(most):
        if (
            search.size[0] == 0
            or search.keys[0] >= max(best, 0.0) - PRECISION
            or (best <= 0.0 and search.q.shape[0] > 1)
        ):
            over = True
            break
        key, subject = search.keys[0], search.stretches[0, 0]
        low, high = search.stretches[0, 1], search.stretches[0, 2]
        drop_top(search)
        kept, travel, found, best = _look_at(body, world, search, found, subject, low, high, best)
        k = (low + high) // 2
        if low < k and travel[0] > 0.0:
            push(search, max(key, kept[0]), subject, low, k)
        if k + 1 < high and travel[1] > 0.0:
            push(search, max(key, kept[1]), subject, k + 1, high)
    return found[1 : int(found[0, 0]) + 1], best, over
