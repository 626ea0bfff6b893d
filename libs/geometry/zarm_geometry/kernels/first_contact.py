"""Whether a timed motion keeps a margin: slabs that separate two shapes throughout intervals of the motion.

An interval runs from one sample to another. During it, each point of the robot stays within `sag` of the chords between
its positions at the start, in the middle and at the end. So a slab that separates two shapes at these three moments by
`sag` more than required separates them all the time, and nothing between samples is missed. The sag shrinks with the
square of the duration; where it is too large, the interval is split in two. Each subject is checked by itself, interval
by interval in order of time.
"""

from __future__ import annotations

import math

import numpy as np

from zarm_geometry.kernels.arrays import Pointer
from zarm_geometry.kernels.clearance_search import COUNT, FIRST, Obstacles
from zarm_geometry.kernels.compiled import inlined, kernel
from zarm_geometry.kernels.convex import Extents, Vector, core_gap, core_point, core_reach, turned, turned_back
from zarm_geometry.kernels.motion import (
    EXTENTS,
    POSE,
    Motion,
    MotionBody,
    Movers,
    Solids,
    View,
    extents_of,
    place,
    turn_of,
    view_of,
)
from zarm_trajectory.arrays import Bits

Box = tuple[float, float, float, float, float, float]
"""An axis-aligned box: its lower and its upper corner."""

COARSE = 0.02
"""An interval with a larger sag (m) is split in two as soon as anything is near it."""
CROWD = 48
"""An interval during which a link moves far is split in two once it is near more obstacles than this."""
KEPT, NEARER, CUT = 0, 1, 2
"""Results of checking an interval: the margin is kept, it is not proven to be kept, or the interval should be split
first.
"""


@inlined
def _measure(view: View, node: int, first: int, last: int) -> None:
    """Compute how the joints move during an interval, unless that is known."""
    if view.measured[node] != 0:
        return
    view.measured[node] = 1
    begin = view.time[first]
    span = view.time[last] - begin
    for j in range(view.dof):
        start = view.q[view.dof * first + j]
        moved = view.q[view.dof * last + j] - start
        uneven = 0.0
        for k in range(first + 1, last):
            even = start + moved * ((view.time[k] - begin) / span)
            uneven = max(uneven, abs(view.q[view.dof * k + j] - even))
        view.moved[view.dof * node + j] = abs(moved)
        view.uneven[view.dof * node + j] = uneven + view.bend[j]


@inlined
def _sag(view: View, subject: int, node: int, first: int, last: int) -> float:
    """Upper bound (m) on how far a point of a subject deviates from straight uniform motion between its positions at
    both ends of an interval.

    For a point x, while q moves uniformly from one end to the other by m, |x''| is at most the sum over joints i, j of
    |m_i| |m_j| times the reach of the outer of the two, and a curve deviates from its chord by at most an eighth of
    that.
    """
    _measure(view, node, first, last)
    sag, inner, curve = 0.0, 0.0, 0.0
    path = (FIRST + view.dof) * subject
    for at in range(path + FIRST + view.paths[path + COUNT] - 1, path + FIRST - 1, -1):
        j = view.paths[at]
        reach = view.reach[view.dof * subject + j]
        moved = view.moved[view.dof * node + j]
        sag += reach * view.uneven[view.dof * node + j]
        curve += reach * moved * (moved + 2.0 * inner)
        inner += moved
    return sag + 0.125 * curve


@inlined
def _along(n: Vector, frames: Pointer, at: int, core: Extents, other: Pointer, where: int, shift: Vector) -> float:
    """The smallest n * x over a core, with `n` given in the frame `other[where]` and x relative to that frame's
    displaced origin.
    """
    n0, n1, n2 = turned(turn_of(other, where), n)
    x = frames[at + 3] - other[where + 3] - shift[0]
    y = frames[at + 7] - other[where + 7] - shift[1]
    z = frames[at + 11] - other[where + 11] - shift[2]
    along: float = n0 * x + n1 * y + n2 * z
    if core[0] + core[1] + core[2] + core[3] > 0.0:
        along -= core_reach(turned_back(turn_of(frames, at), (-n0, -n1, -n2)), core)
    return along


@kernel
def _apart(
    frames: Pointer, a: int, m: int, b: int, core: Extents,
    others: Pointer, oa: int, om: int, ob: int, other: Extents,
    early: Vector, middle: Vector, late: Vector, need: float,
) -> float:  # fmt: skip
    """Width (m) of one slab that separates two cores at three moments. If the first slab tried is narrower than `need`,
    a second one is tried, and the wider of the two counts.

    The frames of the first core start at `frames[a]`, `frames[m]` and `frames[b]`, those of the other at `others[oa]`,
    `others[om]` and `others[ob]`; the other core is also displaced by `early`, `middle` and `late`.
    """
    turn = turn_of(others, om)
    x = frames[m + 3] - others[om + 3] - middle[0]
    y = frames[m + 7] - others[om + 7] - middle[1]
    z = frames[m + 11] - others[om + 11] - middle[2]
    center = turned_back(turn, (x, y, z))
    q = core_point(center, other)
    n0, n1, n2 = center[0] - q[0], center[1] - q[1], center[2] - q[2]
    length = math.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
    least = -math.inf
    n = (0.0, 0.0, 1.0)
    for attempt in range(2):
        if attempt == 0:
            if length < 1e-9:
                continue
            n = (n0 / length, n1 / length, n2 / length)
        else:
            if core[0] + core[1] + core[2] + core[3] == 0.0:
                return least
            mine = turn_of(frames, m)
            u0, u1, u2 = turned_back(turn, (mine[0], mine[3], mine[6]))
            v0, v1, v2 = turned_back(turn, (mine[1], mine[4], mine[7]))
            w0, w1, w2 = turned_back(turn, (mine[2], mine[5], mine[8]))
            own = (u0, v0, w0, u1, v1, w1, u2, v2, w2)
            gap, _, n, _ = core_gap(center, own, core, other, 2.0 * need)
            if gap < need:
                return least
        beyond = core_reach(n, other)
        slab = _along(n, frames, a, core, others, oa, early) - beyond
        slab = min(slab, _along(n, frames, m, core, others, om, middle) - beyond)
        slab = min(slab, _along(n, frames, b, core, others, ob, late) - beyond)
        least = max(least, slab)
        if least >= need:
            break
    return least


@inlined
def _box(view: View, solid: int, a: int, m: int, b: int, wide: float) -> Box:
    """The box around a solid of the robot at three samples, enlarged by `wide` (m) on all sides."""
    core, size = extents_of(view.extents, solid), POSE * view.solids
    wide += view.extents[EXTENTS * solid + 4]
    x0, y0, z0 = math.inf, math.inf, math.inf
    x1, y1, z1 = -math.inf, -math.inf, -math.inf
    for k in (a, m, b):
        at = size * k + POSE * solid
        turn = turn_of(view.frames, at)
        x, y, z = view.frames[at + 3], view.frames[at + 7], view.frames[at + 11]
        rx = core_reach((turn[0], turn[1], turn[2]), core)
        ry = core_reach((turn[3], turn[4], turn[5]), core)
        rz = core_reach((turn[6], turn[7], turn[8]), core)
        x0, y0, z0 = min(x0, x - rx), min(y0, y - ry), min(z0, z - rz)
        x1, y1, z1 = max(x1, x + rx), max(y1, y + ry), max(z1, z + rz)
    return x0 - wide, y0 - wide, z0 - wide, x1 + wide, y1 + wide, z1 + wide


@inlined
def _obstacle_in(view: View, link: int, node: int, box: Box) -> int:
    """The first leaf of the tree, from `node` on, whose obstacle is checked against a link and whose box overlaps `box`;
    the number of nodes if there is none.
    """
    boxes = view.boxes
    while node < view.nodes:
        at = 6 * node
        x, y, z = boxes[at], boxes[at + 1], boxes[at + 2]
        hx, hy, hz = boxes[at + 3] + view.slack, boxes[at + 4] + view.slack, boxes[at + 5] + view.slack
        if (
            x - hx > box[3] or x + hx < box[0] or y - hy > box[4] or y + hy < box[1] or z - hz > box[5] or z + hz < box[2]
        ):  # fmt: skip
            node = view.skip[node]
            continue
        row = view.leaf[node]
        if row >= 0 and view.checked[row] & view.bit[link] != 0:
            return node
        node += 1
    return node


@inlined
def _displacement(view: View, mover: int, k: int) -> Vector:
    """The displacement (m) of a mover by its velocity at sample `k`."""
    passed = view.time[k] - view.since[mover]
    at = 3 * mover
    return passed * view.velocity[at], passed * view.velocity[at + 1], passed * view.velocity[at + 2]


@inlined
def _growth(view: View, mover: int, a: int, b: int) -> float:
    """The most (m) that a point of a mover may be away from its displaced position between two samples."""
    since = view.since[mover]
    growth: float = view.speed[mover] * max(abs(view.time[a] - since), abs(view.time[b] - since))
    return growth


@inlined
def _mover_in(view: View, link: int, mover: int, a: int, b: int, box: Box) -> int:
    """The first mover, from `mover` on, that is checked against a link and may enter the box between two samples; the number of
    movers if none does.
    """
    while mover < view.movers:
        early, late, growth = _displacement(view, mover, a), _displacement(view, mover, b), _growth(view, mover, a, b)
        at = 3 * mover
        if view.mover_checked[mover] & view.bit[link] != 0 and not (
            view.lower[at] + min(early[0], late[0]) - growth > box[3]
            or view.upper[at] + max(early[0], late[0]) + growth < box[0]
            or view.lower[at + 1] + min(early[1], late[1]) - growth > box[4]
            or view.upper[at + 1] + max(early[1], late[1]) + growth < box[1]
            or view.lower[at + 2] + min(early[2], late[2]) - growth > box[5]
            or view.upper[at + 2] + max(early[2], late[2]) + growth < box[2]
        ):
            return mover
        mover += 1
    return mover


@inlined
def _against_world(view: View, link: int, a: int, m: int, b: int, sag: float, margin: float) -> tuple[int, int, int]:
    """Whether a link keeps the margin during an interval: KEPT; NEARER with the part and the obstacle for which it is
    not proven; or CUT if checking both halves separately is faster.

    Obstacles are numbered as the rows of the world, followed by the movers.
    """
    ball = view.parts + link
    radius = view.extents[EXTENTS * ball + 4]
    box = _box(view, ball, a, m, b, sag + margin)
    first, first_mover = _obstacle_in(view, link, 0, box), _mover_in(view, link, 0, a, b, box)
    if first == view.nodes and first_mover == view.movers:
        return KEPT, 0, 0
    whole = b == a + 1
    if sag > COARSE and not whole:
        return CUT, 0, 0
    # If a link moves far for its size, the box of the whole interval overlaps more obstacles than those of both halves.
    span = max(box[3] - box[0], box[4] - box[1], box[5] - box[2]) - 2.0 * (radius + margin)
    long = not whole and span > 0.25 * radius
    crowd = 0
    size = POSE * view.solids
    for i in range(view.first[link], view.first[link + 1]):
        core = extents_of(view.extents, i)
        away = sag + view.extents[EXTENTS * i + 4]
        box = _box(view, i, a, m, b, sag + margin)
        fa, fm, fb = size * a + POSE * i, size * m + POSE * i, size * b + POSE * i
        node, mover = _obstacle_in(view, link, first, box), _mover_in(view, link, first_mover, a, b, box)
        while node < view.nodes or mover < view.movers:
            early = middle = late = (0.0, 0.0, 0.0)
            growth = 0.0
            if node < view.nodes:
                which = name = view.leaf[node]
                others, extents = view.row_pose, view.row_extents
                node = _obstacle_in(view, link, node + 1, box)
            else:
                which, name = mover, view.rows + mover
                others, extents = view.mover_pose, view.mover_extents
                early, middle, late = (
                    _displacement(view, mover, a),
                    _displacement(view, mover, m),
                    _displacement(view, mover, b),
                )
                growth = _growth(view, mover, a, b)
                mover = _mover_in(view, link, mover + 1, a, b, box)
            crowd += 1
            if long and crowd > CROWD:
                return CUT, 0, 0
            need = margin + away + extents[EXTENTS * which + 4] + growth
            at = POSE * which
            other = extents_of(extents, which)
            if _apart(view.frames, fa, fm, fb, core, others, at, at, at, other, early, middle, late, need) < need:
                return NEARER, i, name
    return KEPT, 0, 0


@inlined
def _against_link(
    view: View, one: int, other: int, a: int, m: int, b: int, sag: float, margin: float
) -> tuple[int, int, int]:
    """The same for two links; a part of `other` is -1 minus its index."""
    size = POSE * view.solids
    fa, fm, fb = size * a, size * m, size * b
    f, e = view.frames, view.extents
    still = (0.0, 0.0, 0.0)
    ball, around = view.parts + one, view.parts + other
    for i in range(view.first[one] - 1, view.first[one + 1]):
        whole = i < view.first[one]
        mine = ball if whole else i
        p = POSE * mine
        core = extents_of(e, mine)
        for j in range(view.first[other] - 1, view.first[other + 1]):
            hull = j < view.first[other]
            his = around if hull else j
            o = POSE * his
            need = margin + sag + e[EXTENTS * mine + 4] + e[EXTENTS * his + 4]
            kept = _apart(
                f, fa + p, fm + p, fb + p, core, f, fa + o, fm + o, fb + o, extents_of(e, his), still, still, still, need
            ) >= need  # fmt: skip
            if hull and kept:
                if whole:
                    return KEPT, 0, 0
                break
            if whole:
                if sag > COARSE and b > a + 1:
                    return CUT, 0, 0
                break
            if not hull and not kept:
                return NEARER, i, -1 - j
    return KEPT, 0, 0


@kernel
def first_contact(
    body: MotionBody,
    world: Obstacles,
    standing: Solids,
    checked: Bits,
    movers: Movers,
    motion: Motion,
    margin: float,
) -> tuple[int, int, int]:
    """The first sample after which it is not proven that all subjects keep `margin` (m), or their `room` if that is
    smaller; the number of samples - 1 if all of the motion is proven.

    Also returns the part and what it comes too close to: a row of the world, then the movers, or -1 minus another part.
    `standing` are the world's shapes, and `checked` (n,) the bits of the links against which each is checked, 0 for none.
    """
    view = view_of(body, world, standing, checked, movers, motion)
    until, part, near = motion.q.shape[0] - 1, 0, 0
    stack = np.empty((64, 3), np.int64)
    for subject in range(body.asked.shape[0]):
        if not body.asked[subject]:
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
                sag = max(_sag(view, subject, 2 * node, a, m), _sag(view, subject, 2 * node + 1, m, b))
            else:
                sag = _sag(view, subject, node, a, b)
            place(view, body, motion, a)
            place(view, body, motion, m)
            place(view, body, motion, b)
            if subject < view.links:
                found, i, other = _against_world(view, subject, a, m, b, sag, margin)
            else:
                one, two = body.pairs[subject - view.links, 1], body.pairs[subject - view.links, 0]
                found, i, other = _against_link(view, one, two, a, m, b, sag, min(margin, body.kept_margin[subject]))
            if found == KEPT:
                continue
            if m == a:
                until, part, near = a, i, other
                break
            stack[top, 0], stack[top, 1], stack[top, 2] = 2 * node + 1, m, b
            stack[top + 1, 0], stack[top + 1, 1], stack[top + 1, 2] = 2 * node, a, m
            top += 2
    return until, part, near
