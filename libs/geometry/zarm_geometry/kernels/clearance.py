"""The smallest distance of the robot's exact shapes to the world and to each other along a motion, by branch and bound.

During an interval of the motion, two bodies never come closer than their distance at its middle sample minus how far
they travel from there (Schwarzer, Saha and Latombe, "Adaptive dynamic collision checking for single and multiple
articulated robots in complex environments", 2005). The search always examines the interval with the smallest lower
bound next. The distance at its middle may lower the smallest distance found so far, and the interval is split there.
Once no interval left can contain a smaller distance, the result is proven.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.kernels.arrays import DEEPEST
from zarm_geometry.kernels.compiled import brief, inlined, kernel
from zarm_geometry.kernels.convex import PRECISION, Extents, Turn, Vector, core_distance, core_gap, turned, turned_back
from zarm_geometry.kernels.kinematics import joint_frames
from zarm_geometry.kernels.simd import lowest_bit

Array = NDArray[np.float64]
Index = NDArray[np.int32]
Stretch = tuple[int, int, int]
"""An interval of a motion: its first, middle and last sample."""
Kept = tuple[float, float]
"""Two bounds (m), for the part of an interval before its middle sample and for the part after it."""


ROUGH = 0.2
"""Lower bounds that only decide which boxes to enter, and never the result, may be too small by this fraction."""
_PARTS = 64
"""Parts of a link that descend the tree together."""


class RobotParts(NamedTuple):
    """A robot's exact shapes.

    `origin` (dof, 3, 4), `revolute` (dof,): as in `kinematics.joint_frames`. Per link: `link_joint` (links,): the joint
    that carries it, -1 for the base; `offset` (links, 4, 4): its frame in that joint's frame; `around` (links, 4): its
    bounding sphere, x, y, z, radius in its frame; `spread` (links,): the distance (m) from that sphere's centre to the
    farthest point of its parts' cores; `first` (links + 1,): the index of its first part. Per part: `pose` (parts, 4,
    4) in the link's frame; `extents` (parts, 6): four numbers of the core as in `convex`, the rounding, the distance
    from the centre to the farthest point. `pairs` (m, 2): links that can collide, the one nearer to the base first.

    The subjects of a check are the links, each against the world, followed by the pairs. `reach` (subjects, dof): the
    most (m) that a subject moves per rad (per m if prismatic) of each joint; for a pair, the second link relative to
    the first.
    """

    origin: Array
    revolute: NDArray[np.bool_]
    link_joint: Index
    offset: Array
    around: Array
    spread: Array
    first: Index
    pose: Array
    extents: Array
    pairs: Index
    reach: Array


class Obstacles(NamedTuple):
    """A world: `rows` (n, 17) as `WorldArrays.shapes`, without margin, and the tree of `WorldArrays` over them.

    The boxes are in single precision and may be too small by `slack` (m).
    """

    rows: Array
    boxes: NDArray[np.float32]
    skip: Index
    leaf: Index
    slack: float


class Course(NamedTuple):
    """A motion and the state of the search along it.

    `q` (n, dof); `moved` (n, dof): the path length of each joint since the first sample, in rad (m if prismatic).
    Computed for the samples that are `known` (n,): `frames` (n, links, 3, 4), and `axes` (n, dof, 6): direction of and
    a point on each joint's axis. `keys` and `stretches` are a heap of `size[0]` intervals, ordered by a lower bound (m)
    on their distances; the columns of `stretches` are subject, first sample, last sample + 1. `joints` (dof, 3, 4),
    `centers` (parts, 3), `rates` (parts, dof, 2), `active` and `until` (DEEPEST,) are working memory.
    """

    q: Array
    moved: Array
    frames: Array
    axes: Array
    known: NDArray[np.bool_]
    keys: Array
    stretches: Index
    size: NDArray[np.int64]
    joints: Array
    centers: Array
    rates: Array
    active: NDArray[np.uint64]
    until: NDArray[np.int64]


@brief
def course(body: RobotParts, q: Array, asked: NDArray[np.bool_]) -> Course:
    """Start a search along the motion `q` (n, dof); only subjects that are `asked` (subjects,) are checked."""
    samples, dof = q.shape
    count = 0
    for subject in range(asked.shape[0]):
        count += asked[subject]
    moved = np.zeros((samples, dof))
    for k in range(1, samples):
        for joint in range(dof):
            moved[k, joint] = moved[k - 1, joint] + abs(q[k, joint] - q[k - 1, joint])
    # The intervals of one subject do not overlap, so the heap never grows larger than this.
    keys, stretches = np.empty(samples * count), np.empty((samples * count, 3), np.int32)
    size = np.zeros(1, np.int64)
    for subject in range(asked.shape[0]):
        if asked[subject]:
            i = size[0]
            keys[i] = -np.inf
            stretches[i, 0], stretches[i, 1], stretches[i, 2] = subject, 0, samples
            size[0] = i + 1
    return Course(
        q,
        moved,
        np.empty((samples, body.link_joint.shape[0], 3, 4)),
        np.empty((samples, dof, 6)),
        np.zeros(samples, np.bool_),
        keys,
        stretches,
        size,
        np.empty((dof, 3, 4)),
        np.empty((body.pose.shape[0], 3)),
        np.empty((body.pose.shape[0], dof, 2)),
        np.empty(DEEPEST, np.uint64),
        np.empty(DEEPEST, np.int64),
    )


@inlined
def _push(course: Course, key: float, subject: int, low: int, high: int) -> None:
    """Add an interval to the heap."""
    i = course.size[0]
    course.size[0] = i + 1
    while i > 0 and course.keys[(i - 1) // 2] > key:
        above = (i - 1) // 2
        course.keys[i] = course.keys[above]
        for c in range(3):
            course.stretches[i, c] = course.stretches[above, c]
        i = above
    course.keys[i] = key
    course.stretches[i, 0], course.stretches[i, 1], course.stretches[i, 2] = subject, low, high


@inlined
def _drop_top(course: Course) -> None:
    """Remove the interval with the smallest key from the heap."""
    size = course.size[0] - 1
    course.size[0] = size
    key = course.keys[size]
    i = 0
    while 2 * i + 1 < size:
        below = 2 * i + 1
        if below + 1 < size and course.keys[below + 1] < course.keys[below]:
            below += 1
        if course.keys[below] >= key:
            break
        course.keys[i] = course.keys[below]
        for c in range(3):
            course.stretches[i, c] = course.stretches[below, c]
        i = below
    course.keys[i] = key
    for c in range(3):
        course.stretches[i, c] = course.stretches[size, c]


@inlined
def _arm(course: Course, k: int, joint: int, x: float, y: float, z: float) -> float:
    """Distance (m) of a point from the axis of a joint at sample `k`."""
    a = course.axes
    dx, dy, dz = x - a[k, joint, 3], y - a[k, joint, 4], z - a[k, joint, 5]
    along = dx * a[k, joint, 0] + dy * a[k, joint, 1] + dz * a[k, joint, 2]
    return math.sqrt(max(dx * dx + dy * dy + dz * dz - along * along, 0.0))


@inlined
def _travel(
    body: RobotParts, course: Course, subject: int, stretch: Stretch, x: float, y: float, z: float, core: float
) -> Kept:
    """Upper bounds (m) on how far the points within `core` (m) of a point of a subject move from the first sample of an
    interval to its middle, and from there to the last. At the middle the point is at x, y, z (base frame).

    A joint moves them by at most its rotation times their distance from its axis. Joints further out may increase that
    distance by as much as they move the points, but it never exceeds `RobotParts.reach`.
    """
    low, k, high = stretch
    moved = course.moved
    before, after = 0.0, 0.0
    for joint in range(body.reach.shape[1] - 1, -1, -1):
        reach = body.reach[subject, joint]
        if reach == 0.0:
            continue
        earlier, later = reach, reach
        if body.revolute[joint]:
            arm = _arm(course, k, joint, x, y, z) + core
            earlier, later = min(reach, arm + before), min(reach, arm + after)
        before += earlier * (moved[k, joint] - moved[low, joint])
        after += later * (moved[high, joint] - moved[k, joint])
    return before, after


@inlined
def _rate(body: RobotParts, course: Course, stretch: Stretch, i: int, first: int, last: int, step: int) -> None:
    """Write to `course.rates` upper bounds on how far each joint from `first` to `last` moves a part, in m/rad (1 for
    prismatic joints), before and after the middle of an interval.

    The loop starts at the joint next to the part: the joints already visited may carry the part further away from the
    axis of the next one.
    """
    low, k, high = stretch
    rates, moved = course.rates, course.moved
    core = body.extents[i, 5] - body.extents[i, 4]
    x, y, z = course.centers[i, 0], course.centers[i, 1], course.centers[i, 2]
    before, after = 0.0, 0.0
    for joint in range(first, last + step, step):
        earlier, later = 1.0, 1.0
        if body.revolute[joint]:
            arm = _arm(course, k, joint, x, y, z) + core
            earlier, later = arm + before, arm + after
        rates[i, joint, 0], rates[i, joint, 1] = earlier, later
        before += earlier * (moved[k, joint] - moved[low, joint])
        after += later * (moved[high, joint] - moved[k, joint])


@inlined
def _place(body: RobotParts, course: Course, k: int) -> None:
    """Compute the joint axes and the frames of all links at sample `k`, unless they are known."""
    if course.known[k]:
        return
    course.known[k] = True
    joint_frames(body.origin, body.revolute, course.q[k], course.joints)
    for joint in range(course.joints.shape[0]):
        for r in range(3):
            course.axes[k, joint, r], course.axes[k, joint, 3 + r] = (
                course.joints[joint, r, 2],
                course.joints[joint, r, 3],
            )
    for link in range(body.link_joint.shape[0]):
        j = body.link_joint[link]
        for r in range(3):
            for c in range(4):
                if j < 0:
                    course.frames[k, link, r, c] = body.offset[link, r, c]
                else:
                    value = course.joints[j, r, 3] if c == 3 else 0.0
                    for i in range(3):
                        value += course.joints[j, r, i] * body.offset[link, i, c]
                    course.frames[k, link, r, c] = value


@inlined
def _at(frames: Array, k: int, link: int, x: float, y: float, z: float) -> Vector:
    """A point, given in a link's frame, in the base frame at sample `k`."""
    return (
        frames[k, link, 0, 0] * x + frames[k, link, 0, 1] * y + frames[k, link, 0, 2] * z + frames[k, link, 0, 3],
        frames[k, link, 1, 0] * x + frames[k, link, 1, 1] * y + frames[k, link, 1, 2] * z + frames[k, link, 1, 3],
        frames[k, link, 2, 0] * x + frames[k, link, 2, 1] * y + frames[k, link, 2, 2] * z + frames[k, link, 2, 3],
    )


@inlined
def _place_parts(body: RobotParts, course: Course, k: int, link: int) -> None:
    """Compute the centres of a link's parts in the base frame at sample `k`."""
    for i in range(body.first[link], body.first[link + 1]):
        x, y, z = _at(course.frames, k, link, body.pose[i, 0, 3], body.pose[i, 1, 3], body.pose[i, 2, 3])
        course.centers[i, 0], course.centers[i, 1], course.centers[i, 2] = x, y, z


@inlined
def _part_turn(body: RobotParts, course: Course, k: int, link: int, i: int) -> Turn:
    """The axes of a part in the base frame at sample `k`."""
    f = course.frames
    turn = (
        f[k, link, 0, 0], f[k, link, 0, 1], f[k, link, 0, 2],
        f[k, link, 1, 0], f[k, link, 1, 1], f[k, link, 1, 2],
        f[k, link, 2, 0], f[k, link, 2, 1], f[k, link, 2, 2],
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
    body: RobotParts, world: Obstacles, course: Course, link: int, k: int, i: int, row: int, limit: float
) -> tuple[float, float]:
    """Lower and upper bound (m) on the distance of a part to an obstacle. Once the lower one reaches `limit` (m) it
    need not be tight, and the upper one may be infinite.
    """
    r = world.rows
    core, rounding = _core(r, row, 12), r[row, 16]
    turn = (
        r[row, 0], r[row, 1], r[row, 2], r[row, 4], r[row, 5], r[row, 6], r[row, 8], r[row, 9], r[row, 10],
    )  # fmt: skip
    x, y, z = turned(turn, (course.centers[i, 0], course.centers[i, 1], course.centers[i, 2]))
    center = (x + r[row, 3], y + r[row, 7], z + r[row, 11])
    apart = core_distance(center, core)
    least: float = apart - rounding - body.extents[i, 5]
    if least >= limit:
        return least, math.inf
    if body.extents[i, 4] == body.extents[i, 5] and apart > 0.0:
        return least, least
    own = _part_turn(body, course, k, link, i)
    u = turned(turn, (own[0], own[3], own[6]))
    v = turned(turn, (own[1], own[4], own[7]))
    w = turned(turn, (own[2], own[5], own[8]))
    own = (u[0], v[0], w[0], u[1], v[1], w[1], u[2], v[2], w[2])
    rounded = rounding + body.extents[i, 4]
    lower, upper, _ = core_gap(center, own, _core(body.extents, i, 0), core, limit + rounded)
    return lower - rounded, upper - rounded


@inlined
def _to_box(
    body: RobotParts, world: Obstacles, course: Course, link: int, k: int, i: int, node: int, limit: float
) -> float:
    """A lower bound (m) on the distance of a part to the box of a node; below `limit` (m) it is exact for balls only."""
    b = world.boxes
    half = (b[node, 3] + world.slack, b[node, 4] + world.slack, b[node, 5] + world.slack, 0.0)
    center = (
        course.centers[i, 0] - b[node, 0],
        course.centers[i, 1] - b[node, 1],
        course.centers[i, 2] - b[node, 2],
    )
    apart: float = core_distance(center, half) - body.extents[i, 5]
    if apart >= limit or body.extents[i, 4] == body.extents[i, 5]:
        return apart
    rounding = body.extents[i, 4]
    lower, _, _ = core_gap(
        center, _part_turn(body, course, k, link, i), _core(body.extents, i, 0), half, limit + rounding
    )
    kept: float = max(apart, lower - rounding)
    return kept


@inlined
def _to_world(
    body: RobotParts, world: Obstacles, course: Course, found: Array, link: int, k: int, enough: float, best: float
) -> tuple[float, Array, float]:
    """A lower bound (m), at most `enough`, on the distance of a link to the world; pairs that may be closer than `best`
    are appended to `found`.

    The obstacle near the link's centre is examined first, so that its distance prunes most of the tree. Only the parts
    that come near a node's box descend into it. Distances above `best` need not be exact: boxes that could reduce the
    smallest lower bound by no more than the fraction ROUGH are not entered.
    """
    lowest = nearest = enough
    a = body.around
    cx, cy, cz = _at(course.frames, k, link, a[link, 0], a[link, 1], a[link, 2])
    closest = _closest_row(world, cx, cy, cz, max(best, enough, 0.0) + a[link, 3])
    if closest < 0:
        return lowest, found, best
    _place_parts(body, course, k, link)
    for i in range(body.first[link], body.first[link + 1]):
        lower, upper = _to_row(body, world, course, link, k, i, closest, max(best, nearest, 0.0))
        nearest = min(nearest, lower)
        found, best = _note(found, lower, upper, i, closest, k, best)
    lowest = nearest
    nodes = world.boxes.shape[0]
    for first in range(body.first[link], body.first[link + 1], _PARTS):
        count = min(body.first[link + 1] - first, _PARTS)
        course.active[0] = ~np.uint64(0) >> np.uint64(_PARTS - count)
        course.until[0] = nodes
        level, node = 0, 0
        while node < nodes:
            while node >= course.until[level]:
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
            active, near = course.active[level], np.uint64(0)
            while active != 0:
                i = first + lowest_bit(active)
                bit = active & (~active + np.uint64(1))
                active ^= bit
                apart = _to_box(body, world, course, link, k, i, node, limit)
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
                course.active[level], course.until[level] = near, world.skip[node - 1]
                continue
            while near != 0 and row != closest:
                i = first + lowest_bit(near)
                near &= near - np.uint64(1)
                lower, upper = _to_row(body, world, course, link, k, i, row, max(best, nearest, 0.0))
                nearest = min(nearest, lower)
                found, best = _note(found, lower, upper, i, row, k, best)
        lowest = min(lowest, nearest)
    return lowest, found, best


@inlined
def _to_each_other(
    body: RobotParts,
    course: Course,
    found: Array,
    one: int,
    other: int,
    stretch: Stretch,
    travel: Kept,
    best: float,
) -> tuple[Kept, Array, float]:
    """Lower bounds (m) on the distance of two links before and after the middle of an interval. `one` is the outer
    link; pairs that may be closer than `best` are appended to `found`, where a part of `other` is -1 minus its index.

    A joint brings two points closer by at most its rotation times the smaller of their distances from its axis.
    """
    low, k, high = stretch
    before = after = max(best, 0.0)
    a = body.around
    ax, ay, az = _at(course.frames, k, one, a[one, 0], a[one, 1], a[one, 2])
    bx, by, bz = _at(course.frames, k, other, a[other, 0], a[other, 1], a[other, 2])
    apart = math.sqrt((ax - bx) ** 2 + (ay - by) ** 2 + (az - bz) ** 2) - a[one, 3] - a[other, 3]
    if apart >= before + max(travel[0], travel[1]):
        return (before, after), found, best
    _place_parts(body, course, k, one)
    _place_parts(body, course, k, other)
    inner, outer = body.link_joint[other] + 1, body.link_joint[one]
    for j in range(body.first[other], body.first[other + 1]):
        _rate(body, course, stretch, j, inner, outer, 1)
    rates, moved = course.rates, course.moved
    p = course.centers
    for i in range(body.first[one], body.first[one + 1]):
        reach = body.extents[i, 5] + a[other, 3]
        apart = math.sqrt((p[i, 0] - bx) ** 2 + (p[i, 1] - by) ** 2 + (p[i, 2] - bz) ** 2)
        if apart - reach >= max(best, before + travel[0], after + travel[1], 0.0):
            continue
        _rate(body, course, stretch, i, outer, inner, -1)
        for j in range(body.first[other], body.first[other + 1]):
            own_before, own_after = 0.0, 0.0
            for joint in range(inner, outer + 1):
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
                turn = _part_turn(body, course, k, other, j)
                own = _part_turn(body, course, k, one, i)
                u = turned_back(turn, (own[0], own[3], own[6]))
                v = turned_back(turn, (own[1], own[4], own[7]))
                w = turned_back(turn, (own[2], own[5], own[8]))
                own = (u[0], v[0], w[0], u[1], v[1], w[1], u[2], v[2], w[2])
                center = turned_back(turn, (x, y, z))
                lower, upper, _ = core_gap(
                    center, own, _core(body.extents, i, 0), _core(body.extents, j, 0), limit + rounded
                )
                lower, upper = lower - rounded, upper - rounded
            before, after = min(before, lower - own_before), min(after, lower - own_after)
            found, best = _note(found, lower, upper, i, -1 - j, k, best)
    return (before, after), found, best


@kernel
def look(body: RobotParts, world: Obstacles, course: Course, best: float, most: int) -> tuple[Array, float, bool]:
    """Examine up to `most` intervals in search of distances below `best` (m).

    Returns the pairs that may have the smallest distance, as rows of lower and upper bound (m), part, row of the world
    (or -1 minus another part), sample; the smallest upper bound so far; and whether the search is complete. If it is,
    no distance of any two shapes at any sample is more than PRECISION smaller than the smallest in these rows. A
    negative lower bound is minus an upper bound on the penetration depth. At a single sample all collisions are found;
    along a motion the search ends at the first.
    """
    links = body.link_joint.shape[0]
    found = np.empty((64, 5))
    found[0, 0] = 0.0
    over = False
    for _ in range(most):
        if (
            course.size[0] == 0
            or course.keys[0] >= max(best, 0.0) - PRECISION
            or (best <= 0.0 and course.q.shape[0] > 1)
        ):
            over = True
            break
        key, subject = course.keys[0], course.stretches[0, 0]
        low, high = course.stretches[0, 1], course.stretches[0, 2]
        _drop_top(course)
        k = (low + high) // 2
        stretch = low, k, high - 1
        _place(body, course, k)
        one = subject if subject < links else int(body.pairs[subject - links, 1])
        x, y, z = _at(course.frames, k, one, body.around[one, 0], body.around[one, 1], body.around[one, 2])
        travel = _travel(body, course, subject, stretch, x, y, z, body.spread[one])
        if subject < links:
            enough = max(best, 0.0) + max(travel[0], travel[1])
            lowest, found, best = _to_world(body, world, course, found, one, k, enough, best)
            kept = lowest - travel[0], lowest - travel[1]
        else:
            other = body.pairs[subject - links, 0]
            kept, found, best = _to_each_other(body, course, found, one, other, stretch, travel, best)
        if low < k and travel[0] > 0.0:
            _push(course, max(key, kept[0]), subject, low, k)
        if k + 1 < high and travel[1] > 0.0:
            _push(course, max(key, kept[1]), subject, k + 1, high)
    return found[1 : int(found[0, 0]) + 1], best, over
