"""Whether a timed motion keeps its distance: slabs that stay between two shapes over whole stretches of the motion.

A stretch is what happens from one sample to another. On it each point of the robot stays within `sag` of the chords between
its places at the start, the middle and the end. So a slab that separates two shapes at these three moments by `sag` more
than is asked for separates them all the time; nothing between samples is missed. Sags shrink with the square of the time,
and where one is too large, the stretch is cut in two. Stretches are looked at in the order of time, each subject by itself.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.kernels.clearance import Obstacles, RobotParts
from zarm_geometry.kernels.compiled import inlined, kernel
from zarm_geometry.kernels.convex import Turn, Vector, core_gap, core_point, core_reach, turned, turned_back
from zarm_geometry.kernels.kinematics import joint_frames

Array = NDArray[np.float64]

COARSE = 0.05
"""A stretch with a larger sag (m) is cut in two at once when something is near it."""


class Movers(NamedTuple):
    """Obstacles (n, 17) that move: at time t (s) each is displaced by `velocity` (n, 3) times t - `since` (n,).

    Besides, every point of it may be `speed` (n,) times that time away from there. What stands still does neither.
    """

    rows: Array
    velocity: Array
    speed: Array
    since: Array
    lower: Array
    upper: Array


class Motion(NamedTuple):
    """A motion of N samples and what is known of it.

    `time` (N,), `q` (N, dof); `bend` (dof,): how far (rad) a joint may be from the straight line between two samples.
    Of the samples that are `placed` (N,): `parts` (N, parts, 12), the frames of the parts, row by row, and `around` (N,
    links, 3), the centres of the spheres around the links. Of the stretches that are `measured` (4 N,), numbered as a binary
    tree from 1 on: by how much each joint moves, and how far it is at most from moving evenly, `moved` and `uneven` (4 N, dof).
    """

    time: Array
    q: Array
    bend: Array
    placed: NDArray[np.bool_]
    parts: Array
    around: Array
    measured: NDArray[np.bool_]
    moved: Array
    uneven: Array
    joints: Array


def motion(body: RobotParts, time: Array, q: Array, acceleration: Array) -> Motion:
    """The motion `q` (N, dof) at `time` (N,), N > 1, whose joints accelerate by at most `acceleration` (dof,)."""
    samples, dof = q.shape
    return Motion(
        time=time,
        q=q,
        bend=acceleration * (float(np.diff(time).max()) ** 2 / 8),
        placed=np.zeros(samples, np.bool_),
        parts=np.empty((samples, len(body.pose), 12)),
        around=np.empty((samples, len(body.link_joint), 3)),
        measured=np.zeros(4 * samples, np.bool_),
        moved=np.empty((4 * samples, dof)),
        uneven=np.empty((4 * samples, dof)),
        joints=np.empty_like(body.origin),
    )


@inlined
def _place(body: RobotParts, motion: Motion, k: int) -> None:
    """All parts at sample `k`."""
    if motion.placed[k]:
        return
    motion.placed[k] = True
    joint_frames(body.origin, body.revolute, motion.q[k], motion.joints)
    for link in range(body.link_joint.shape[0]):
        j = body.link_joint[link]
        if body.first[link] == body.first[link + 1]:
            continue
        o = body.offset
        if j < 0:
            r00, r01, r02, x = o[link, 0, 0], o[link, 0, 1], o[link, 0, 2], o[link, 0, 3]
            r10, r11, r12, y = o[link, 1, 0], o[link, 1, 1], o[link, 1, 2], o[link, 1, 3]
            r20, r21, r22, z = o[link, 2, 0], o[link, 2, 1], o[link, 2, 2], o[link, 2, 3]
        else:
            m = motion.joints
            a, b, c = m[j, 0, 0], m[j, 0, 1], m[j, 0, 2]
            r00, r01, r02, x = (
                a * o[link, 0, 0] + b * o[link, 1, 0] + c * o[link, 2, 0],
                a * o[link, 0, 1] + b * o[link, 1, 1] + c * o[link, 2, 1],
                a * o[link, 0, 2] + b * o[link, 1, 2] + c * o[link, 2, 2],
                a * o[link, 0, 3] + b * o[link, 1, 3] + c * o[link, 2, 3] + m[j, 0, 3],
            )
            a, b, c = m[j, 1, 0], m[j, 1, 1], m[j, 1, 2]
            r10, r11, r12, y = (
                a * o[link, 0, 0] + b * o[link, 1, 0] + c * o[link, 2, 0],
                a * o[link, 0, 1] + b * o[link, 1, 1] + c * o[link, 2, 1],
                a * o[link, 0, 2] + b * o[link, 1, 2] + c * o[link, 2, 2],
                a * o[link, 0, 3] + b * o[link, 1, 3] + c * o[link, 2, 3] + m[j, 1, 3],
            )
            a, b, c = m[j, 2, 0], m[j, 2, 1], m[j, 2, 2]
            r20, r21, r22, z = (
                a * o[link, 0, 0] + b * o[link, 1, 0] + c * o[link, 2, 0],
                a * o[link, 0, 1] + b * o[link, 1, 1] + c * o[link, 2, 1],
                a * o[link, 0, 2] + b * o[link, 1, 2] + c * o[link, 2, 2],
                a * o[link, 0, 3] + b * o[link, 1, 3] + c * o[link, 2, 3] + m[j, 2, 3],
            )
        s = body.around
        u, v, w = s[link, 0], s[link, 1], s[link, 2]
        motion.around[k, link, 0] = r00 * u + r01 * v + r02 * w + x
        motion.around[k, link, 1] = r10 * u + r11 * v + r12 * w + y
        motion.around[k, link, 2] = r20 * u + r21 * v + r22 * w + z
        for i in range(body.first[link], body.first[link + 1]):
            out = motion.parts
            for col in range(4):
                u, v, w = body.pose[i, 0, col], body.pose[i, 1, col], body.pose[i, 2, col]
                last = 1.0 if col == 3 else 0.0
                out[k, i, col] = r00 * u + r01 * v + r02 * w + last * x
                out[k, i, 4 + col] = r10 * u + r11 * v + r12 * w + last * y
                out[k, i, 8 + col] = r20 * u + r21 * v + r22 * w + last * z


@inlined
def _measure(motion: Motion, node: int, first: int, last: int) -> None:
    """How the joints move on a stretch."""
    if motion.measured[node]:
        return
    motion.measured[node] = True
    for j in range(motion.q.shape[1]):
        begin = motion.q[first, j]
        moved = motion.q[last, j] - begin
        uneven = 0.0
        if last > first + 1:
            pace = moved / (motion.time[last] - motion.time[first])
            for k in range(first + 1, last):
                uneven = max(uneven, abs(motion.q[k, j] - begin - pace * (motion.time[k] - motion.time[first])))
        motion.moved[node, j] = abs(moved)
        motion.uneven[node, j] = uneven + motion.bend[j]


@inlined
def _sag(body: RobotParts, motion: Motion, subject: int, node: int, first: int, last: int) -> float:
    """How far (m) a point of a subject is at most from moving evenly and straight from its start to its end on a stretch.

    With x a point of it and q going evenly from one end to the other by m, |x''| <= sum over joints i, j of |m_i| |m_j| times
    the reach of the outer one of both, and a curve is within an eighth of that from its chord.
    """
    _measure(motion, node, first, last)
    sag, inner, curve = 0.0, 0.0, 0.0
    for j in range(motion.q.shape[1]):
        reach = body.reach[subject, j]
        if reach > 0.0:
            moved = motion.moved[node, j]
            sag += reach * motion.uneven[node, j]
            curve += reach * moved * (moved + 2.0 * inner)
            inner += moved
    return sag + 0.125 * curve


@inlined
def _center(motion: Motion, k: int, i: int) -> Vector:
    """The centre of a part."""
    p = motion.parts
    return p[k, i, 3], p[k, i, 7], p[k, i, 11]


@inlined
def _turn(motion: Motion, k: int, i: int) -> Turn:
    """The axes of a part."""
    p = motion.parts
    return (
        p[k, i, 0], p[k, i, 1], p[k, i, 2],
        p[k, i, 4], p[k, i, 5], p[k, i, 6],
        p[k, i, 8], p[k, i, 9], p[k, i, 10],
    )  # fmt: skip


@inlined
def _relative(turn: Turn, own: Turn) -> Turn:
    """The axes `own` in the frame whose axes are the rows of `turn`."""
    u = turned(turn, (own[0], own[3], own[6]))
    v = turned(turn, (own[1], own[4], own[7]))
    w = turned(turn, (own[2], own[5], own[8]))
    return u[0], v[0], w[0], u[1], v[1], w[1], u[2], v[2], w[2]


@inlined
def _part_reach(body: RobotParts, motion: Motion, k: int, i: int, n: Vector) -> float:
    """How far part `i` reaches from its centre against the direction `n`, without its rounding."""
    e = body.extents
    if e[i, 4] == e[i, 5]:
        return 0.0
    back = turned_back(_turn(motion, k, i), (-n[0], -n[1], -n[2]))
    return core_reach(back, (e[i, 0], e[i, 1], e[i, 2], e[i, 3]))


@inlined
def _slab(
    body: RobotParts, motion: Motion, i: int, a: int, m: int, b: int, n: Vector, drift: Vector, since: float
) -> float:
    """The smallest n * x of a part's core at three moments, in the frame of something that drifts."""
    least = math.inf
    rate = n[0] * drift[0] + n[1] * drift[1] + n[2] * drift[2]
    for k in (a, m, b):
        p = motion.parts
        along = n[0] * p[k, i, 3] + n[1] * p[k, i, 7] + n[2] * p[k, i, 11]
        along -= _part_reach(body, motion, k, i, n) + rate * (motion.time[k] - since)
        least = min(least, along)
    return least


@inlined
def _to_row(
    body: RobotParts,
    motion: Motion,
    i: int,
    rows: Array,
    row: int,
    a: int,
    m: int,
    b: int,
    drift: Vector,
    since: float,
    need: float,
) -> float:
    """How far (m) part `i` and an obstacle stay apart at least at three moments, with one slab; no better than `need` calls for."""
    r = rows
    turn = (
        r[row, 0], r[row, 1], r[row, 2], r[row, 4], r[row, 5], r[row, 6], r[row, 8], r[row, 9], r[row, 10],
    )  # fmt: skip
    core = (r[row, 12], r[row, 13], r[row, 14], r[row, 15])
    rounded = r[row, 16] + body.extents[i, 4]
    late = motion.time[m] - since
    x, y, z = _center(motion, m, i)
    x, y, z = turned(turn, (x - late * drift[0], y - late * drift[1], z - late * drift[2]))
    center = (x + r[row, 3], y + r[row, 7], z + r[row, 11])
    q = core_point(center, core)
    n0, n1, n2 = center[0] - q[0], center[1] - q[1], center[2] - q[2]
    length = math.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
    lower = -math.inf
    if length > 1e-9:
        n = (n0 / length, n1 / length, n2 / length)
        beyond = core_reach(n, core) - (n[0] * r[row, 3] + n[1] * r[row, 7] + n[2] * r[row, 11])
        lower = _slab(body, motion, i, a, m, b, turned_back(turn, n), drift, since) - beyond - rounded
    if lower >= need or body.extents[i, 4] == body.extents[i, 5]:
        return lower
    own = (body.extents[i, 0], body.extents[i, 1], body.extents[i, 2], body.extents[i, 3])
    gap, _, n = core_gap(center, _relative(turn, _turn(motion, m, i)), own, core, 2.0 * abs(need) + rounded)
    if gap - rounded < need:
        return lower
    beyond = core_reach(n, core) - (n[0] * r[row, 3] + n[1] * r[row, 7] + n[2] * r[row, 11])
    return max(lower, _slab(body, motion, i, a, m, b, turned_back(turn, n), drift, since) - beyond - rounded)


@inlined
def _to_part(body: RobotParts, motion: Motion, i: int, j: int, a: int, m: int, b: int, need: float) -> float:
    """The same of two parts, in the frame of part `j`."""
    e = body.extents
    core, own = (e[j, 0], e[j, 1], e[j, 2], e[j, 3]), (e[i, 0], e[i, 1], e[i, 2], e[i, 3])
    rounded = e[i, 4] + e[j, 4]
    x, y, z = _center(motion, m, i)
    u, v, w = _center(motion, m, j)
    turn = _turn(motion, m, j)
    center = turned_back(turn, (x - u, y - v, z - w))
    q = core_point(center, core)
    n0, n1, n2 = center[0] - q[0], center[1] - q[1], center[2] - q[2]
    length = math.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
    lower = -math.inf
    if length > 1e-9:
        n = (n0 / length, n1 / length, n2 / length)
        lower = _slab_between(body, motion, i, j, a, m, b, n) - core_reach(n, core) - rounded
    if lower >= need or e[i, 4] == e[i, 5]:
        return lower
    mine = _turn(motion, m, i)
    x0, x1, x2 = turned_back(turn, (mine[0], mine[3], mine[6]))
    y0, y1, y2 = turned_back(turn, (mine[1], mine[4], mine[7]))
    z0, z1, z2 = turned_back(turn, (mine[2], mine[5], mine[8]))
    gap, _, n = core_gap(center, (x0, y0, z0, x1, y1, z1, x2, y2, z2), own, core, 2.0 * abs(need) + rounded)
    if gap - rounded < need:
        return lower
    return max(lower, _slab_between(body, motion, i, j, a, m, b, n) - core_reach(n, core) - rounded)


@inlined
def _slab_between(body: RobotParts, motion: Motion, i: int, j: int, a: int, m: int, b: int, n: Vector) -> float:
    """The smallest n * x of the core of part `i` at three moments, in the frame of part `j`."""
    least = math.inf
    for k in (a, m, b):
        x, y, z = _center(motion, k, i)
        u, v, w = _center(motion, k, j)
        n0, n1, n2 = turned(_turn(motion, k, j), n)
        along = n0 * (x - u) + n1 * (y - v) + n2 * (z - w) - _part_reach(body, motion, k, i, (n0, n1, n2))
        least = min(least, along)
    return least


@inlined
def _against_world(
    body: RobotParts,
    world: Obstacles,
    alive: NDArray[np.bool_],
    movers: Movers,
    motion: Motion,
    link: int,
    a: int,
    m: int,
    b: int,
    sag: float,
    margin: float,
    clearance: float,
) -> tuple[float, int, int]:
    """What a link keeps clear of on a stretch, at most `clearance`, and the part and obstacle where it is less than `margin`.

    Obstacles are numbered as rows of the world, and then the movers.
    """
    s = motion.around
    wide = body.around[link, 3] + sag + clearance
    x0 = min(s[a, link, 0], s[m, link, 0], s[b, link, 0]) - wide
    x1 = max(s[a, link, 0], s[m, link, 0], s[b, link, 0]) + wide
    y0 = min(s[a, link, 1], s[m, link, 1], s[b, link, 1]) - wide
    y1 = max(s[a, link, 1], s[m, link, 1], s[b, link, 1]) + wide
    z0 = min(s[a, link, 2], s[m, link, 2], s[b, link, 2]) - wide
    z1 = max(s[a, link, 2], s[m, link, 2], s[b, link, 2]) + wide
    still = (0.0, 0.0, 0.0)
    lowest = clearance
    node = 0
    boxes = world.boxes
    while node < boxes.shape[0]:
        x, y, z = boxes[node, 0], boxes[node, 1], boxes[node, 2]
        hx, hy, hz = boxes[node, 3] - world.grown, boxes[node, 4] - world.grown, boxes[node, 5] - world.grown
        if x - hx > x1 or x + hx < x0 or y - hy > y1 or y + hy < y0 or z - hz > z1 or z + hz < z0:
            node = world.skip[node]
            continue
        row = world.leaf[node]
        node += 1
        if row < 0 or not alive[row]:
            continue
        if sag > COARSE and b > a + 1:
            return -math.inf, 0, 0
        for i in range(body.first[link], body.first[link + 1]):
            lower = _to_row(body, motion, i, world.rows, row, a, m, b, still, 0.0, margin + sag) - sag
            if lower < margin:
                return lower, i, row
            lowest = min(lowest, lower)
    for mover in range(movers.rows.shape[0]):
        since = movers.since[mover]
        early, late = motion.time[a] - since, motion.time[b] - since
        growth = movers.speed[mover] * max(abs(early), abs(late))
        drift = (movers.velocity[mover, 0], movers.velocity[mover, 1], movers.velocity[mover, 2])
        low, high = movers.lower, movers.upper
        if (
            low[mover, 0] + min(drift[0] * early, drift[0] * late) - growth > x1
            or high[mover, 0] + max(drift[0] * early, drift[0] * late) + growth < x0
            or low[mover, 1] + min(drift[1] * early, drift[1] * late) - growth > y1
            or high[mover, 1] + max(drift[1] * early, drift[1] * late) + growth < y0
            or low[mover, 2] + min(drift[2] * early, drift[2] * late) - growth > z1
            or high[mover, 2] + max(drift[2] * early, drift[2] * late) + growth < z0
        ):
            continue
        less = sag + growth
        for i in range(body.first[link], body.first[link + 1]):
            lower = _to_row(body, motion, i, movers.rows, mover, a, m, b, drift, since, margin + less) - less
            if lower < margin:
                return lower, i, world.rows.shape[0] + mover
            lowest = min(lowest, lower)
    return lowest, 0, 0


@inlined
def _against_link(
    body: RobotParts,
    motion: Motion,
    one: int,
    other: int,
    a: int,
    m: int,
    b: int,
    sag: float,
    margin: float,
    clearance: float,
) -> tuple[float, int, int]:
    """The same of two links; a part of `other` is -1 minus its index."""
    s = motion.around
    frame = body.first[other]
    x, y, z = s[m, one, 0] - s[m, other, 0], s[m, one, 1] - s[m, other, 1], s[m, one, 2] - s[m, other, 2]
    length = math.sqrt(x * x + y * y + z * z)
    around = body.around[one, 3] + body.around[other, 3] + sag
    if length > 1e-9:
        n = turned_back(_turn(motion, m, frame), (x / length, y / length, z / length))
        least = math.inf
        for k in (a, m, b):
            n0, n1, n2 = turned(_turn(motion, k, frame), n)
            x, y, z = s[k, one, 0] - s[k, other, 0], s[k, one, 1] - s[k, other, 1], s[k, one, 2] - s[k, other, 2]
            least = min(least, n0 * x + n1 * y + n2 * z)
        if least - around >= clearance:
            return clearance, 0, 0
    if sag > COARSE and b > a + 1:
        return -math.inf, 0, 0
    lowest = clearance
    for i in range(body.first[one], body.first[one + 1]):
        for j in range(body.first[other], body.first[other + 1]):
            lower = _to_part(body, motion, i, j, a, m, b, margin + sag) - sag
            if lower < margin:
                return lower, i, -1 - j
            lowest = min(lowest, lower)
    return lowest, 0, 0


@kernel
def first_contact(
    body: RobotParts,
    world: Obstacles,
    alive: NDArray[np.bool_],
    movers: Movers,
    asked: NDArray[np.bool_],
    motion: Motion,
    margin: float,
    clearance: float,
) -> tuple[int, int, int, float]:
    """The first sample after which it is not proven that all keep `margin` (m), the number of samples - 1 where all is.

    Then the part and what it comes too near to: a row of the world, after those the movers, or -1 minus another part. Last
    what is proven to be clear up to there, at most `clearance`, which is not below `margin`. `asked` (subjects,) are looked at.
    """
    links = body.link_joint.shape[0]
    until, part, near = motion.q.shape[0] - 1, 0, 0
    stack = np.empty((64, 3), np.int64)
    for subject in range(asked.shape[0]):
        if not asked[subject]:
            continue
        stack[0, 0], stack[0, 1], stack[0, 2] = 1, 0, motion.q.shape[0] - 1
        top = 1
        while top > 0:
            top -= 1
            node, a, b = stack[top, 0], stack[top, 1], stack[top, 2]
            if a >= until:
                continue
            m = (a + b) // 2
            if m > a:
                before = _sag(body, motion, subject, 2 * node, a, m)
                sag = max(before, _sag(body, motion, subject, 2 * node + 1, m, b))
            else:
                sag = _sag(body, motion, subject, node, a, b)
            _place(body, motion, a)
            _place(body, motion, m)
            _place(body, motion, b)
            if subject < links:
                lower, i, other = _against_world(
                    body, world, alive, movers, motion, subject, a, m, b, sag, margin, clearance
                )
            else:
                one, two = body.pairs[subject - links, 1], body.pairs[subject - links, 0]
                lower, i, other = _against_link(body, motion, one, two, a, m, b, sag, margin, clearance)
            if lower >= margin:
                clearance = min(clearance, lower)
            elif m == a:
                until, part, near = a, i, other
                break
            else:
                stack[top, 0], stack[top, 1], stack[top, 2] = 2 * node + 1, m, b
                stack[top + 1, 0], stack[top + 1, 1], stack[top + 1, 2] = 2 * node, a, m
                top += 2
    return until, part, near, clearance
