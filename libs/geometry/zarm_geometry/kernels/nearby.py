"""The distances of a robot to everything near one configuration, and their gradients by the joints."""

from __future__ import annotations

import math

from zarm_geometry.kernels.arrays import Pointer
from zarm_geometry.kernels.clearance_search import COUNT, FIRST, OWN, Obstacles
from zarm_geometry.kernels.compiled import inlined, kernel
from zarm_geometry.kernels.convex import Extents, Turn, Vector, core_gap, separation, turned, turned_back
from zarm_geometry.kernels.motion import (
    EXTENTS,
    POSE,
    Motion,
    MotionBody,
    Movers,
    Solids,
    extents_of,
    place,
    turn_of,
    view_of,
)
from zarm_trajectory.arrays import Array, Bits

GRADIENT = 3
"""The column in which the gradient starts in a row of `near`."""
_PARALLEL = 1e-3
"""Sine of the angle (rad) to an edge or a face below which a slab is parallel to it."""


@inlined
def _gap(
    frames: Pointer, at: int, core: Extents, others: Pointer, where: int, other: Extents, shift: Vector
) -> tuple[float, Vector, Vector]:
    """A lower bound (m) on the distance of two cores, the unit vector from the other core to the first in the base
    frame, and the point of the first core that is nearest along it. If they overlap the bound is negative: moving one
    core by that much along the vector separates them.
    """
    turn, mine = turn_of(others, where), turn_of(frames, at)
    x = frames[at + 3] - others[where + 3] - shift[0]
    y = frames[at + 7] - others[where + 7] - shift[1]
    z = frames[at + 11] - others[where + 11] - shift[2]
    u0, u1, u2 = turned_back(turn, (mine[0], mine[3], mine[6]))
    v0, v1, v2 = turned_back(turn, (mine[1], mine[4], mine[7]))
    w0, w1, w2 = turned_back(turn, (mine[2], mine[5], mine[8]))
    own = (u0, v0, w0, u1, v1, w1, u2, v2, w2)
    c = turned_back(turn, (x, y, z))
    gap, _, n, p = core_gap(c, own, core, other, math.inf)
    if gap < 0.0:  # they overlap: take the shortest way out along the axes of either core
        for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (u0, u1, u2), (v0, v1, v2), (w0, w1, w2)):
            sign = 1.0 if axis[0] * c[0] + axis[1] * c[1] + axis[2] * c[2] >= 0.0 else -1.0
            out = (sign * axis[0], sign * axis[1], sign * axis[2])
            apart = separation(out, c, own, core, other)
            if apart > gap:
                gap, n = apart, out
    s0, s1, s2 = turned(turn, _support(n, (p[0] - c[0], p[1] - c[1], p[2] - c[2]), c, own, core, other))
    n = turned(turn, n)
    return gap, n, (frames[at + 3] + s0, frames[at + 7] + s1, frames[at + 11] + s2)


@inlined
def _support(n: Vector, p: Vector, c: Vector, turn: Turn, core: Extents, other: Extents) -> Vector:
    """The point of a core, from its centre `c`, that is furthest against `n`, all in the frame of the other core.

    If an edge or a face is, take the point of it that is nearest to `p`; and if the other core lies along it, the
    middle of what they share: either end would let the other end come closer unseen.
    """
    against, near = turned_back(turn, n), turned_back(turn, p)
    flat = math.sqrt(against[0] * against[0] + against[1] * against[1])
    disc = core[3] / flat if flat > _PARALLEL else 0.0
    face = core[3] if flat <= _PARALLEL else 0.0
    x = _along(against[0], near[0] + disc * against[0], core[0] + face) - disc * against[0]
    y = _along(against[1], near[1] + disc * against[1], core[1] + face) - disc * against[1]
    z = _along(against[2], near[2], core[2])
    if other[3] >= 0.0:
        width = other[3] if math.sqrt(n[0] * n[0] + n[1] * n[1]) <= _PARALLEL else 0.0
        reach = (other[0] + width, other[1] + width, other[2])
        if abs(against[0]) <= _PARALLEL and core[0] > 0.0:
            u, q = (turn[0], turn[3], turn[6]), turned(turn, (x, y, z))
            x += _to_middle(x, core[0], u, (q[0] + c[0], q[1] + c[1], q[2] + c[2]), reach)
        if abs(against[1]) <= _PARALLEL and core[1] > 0.0:
            u, q = (turn[1], turn[4], turn[7]), turned(turn, (x, y, z))
            y += _to_middle(y, core[1], u, (q[0] + c[0], q[1] + c[1], q[2] + c[2]), reach)
        if abs(against[2]) <= _PARALLEL and core[2] > 0.0:
            u, q = (turn[2], turn[5], turn[8]), turned(turn, (x, y, z))
            z += _to_middle(z, core[2], u, (q[0] + c[0], q[1] + c[1], q[2] + c[2]), reach)
    return turned(turn, (x, y, z))


@inlined
def _along(against: float, near: float, half: float) -> float:
    """The coordinate of the support point by one axis of a core."""
    if abs(against) > _PARALLEL:
        return -half if against > 0.0 else half
    return min(max(near, -half), half)


@inlined
def _to_middle(at: float, half: float, axis: Vector, q: Vector, reach: Vector) -> float:
    """How far the middle of what two cores share along an axis is from a point at `at` on it, which is `q` in the frame
    of the other core.
    """
    low, high = -half - at, half - at
    for k in range(3):
        if abs(axis[k]) > _PARALLEL:
            one, two = (-reach[k] - q[k]) / axis[k], (reach[k] - q[k]) / axis[k]
            low, high = max(low, min(one, two)), min(high, max(one, two))
    return 0.5 * (low + high) if high > low else 0.0


@inlined
def _note(
    body: MotionBody, motion: Motion, found: Array, count: int, apart: float, pair: tuple[int, int], n: Vector, p: Vector,
    subject: int,
) -> int:  # fmt: skip
    """Store the distance of a subject and its gradient in the next row of `found`, or in place of the largest if it is
    full. Returns how many rows are filled.
    """
    row = count
    if count == found.shape[0]:
        row = 0
        for k in range(1, count):
            if found[k, 0] > found[row, 0]:
                row = k
        if found[row, 0] <= apart:
            return count
    else:
        count += 1
    found[row, 0], found[row, 1], found[row, 2] = apart, pair[0], pair[1]
    frames = motion.joints
    for j in range(motion.q.shape[1]):
        found[row, GRADIENT + j] = 0.0
    own = body.paths[subject, OWN]
    sign = 1.0 if own >= 0 else -1.0
    for at in range(FIRST, FIRST + body.paths[subject, COUNT]):
        j = body.paths[subject, at]
        z0, z1, z2 = frames[j + 1, 0, 2], frames[j + 1, 1, 2], frames[j + 1, 2, 2]
        if body.tree[j, 1] != 0:
            x, y, z = p[0] - frames[j + 1, 0, 3], p[1] - frames[j + 1, 1, 3], p[2] - frames[j + 1, 2, 3]
            rate = n[0] * (z1 * z - z2 * y) + n[1] * (z2 * x - z0 * z) + n[2] * (z0 * y - z1 * x)
        else:
            rate = n[0] * z0 + n[1] * z1 + n[2] * z2
        found[row, GRADIENT + j] = sign * rate
        if j == own:
            sign = -1.0  # what follows moves the other link away
    return count


@kernel
def near(
    body: MotionBody,
    world: Obstacles,
    standing: Solids,
    checked: Bits,
    movers: Movers,
    motion: Motion,
    within: float,
    found: Array,
) -> int:
    """Distances below `within` (m) at the first sample of a motion, of each link to each obstacle and of each pair of
    links.

    Returns how many rows of `found` (n, 3 + dof) are filled: the distance (m), part and obstacle as in
    `first_contact`, and the derivative of the distance by each joint in m/rad (m/m if prismatic). If there are
    more, the largest are left out. Movers are displaced to the time of that sample and enlarged by how far they may
    have strayed.
    """
    view = view_of(body, world, standing, checked, movers, motion)
    place(view, body, motion, 0)
    f, e, count = view.frames, view.extents, 0
    still = (0.0, 0.0, 0.0)
    for link in range(view.links):
        if not body.asked[link]:
            continue
        ball = view.parts + link
        at = POSE * ball
        x, y, z = f[at + 3], f[at + 7], f[at + 11]
        wide = e[EXTENTS * ball + 4] + within
        node, mover = 0, 0
        while node < view.nodes or mover < view.movers:
            shift, growth = still, 0.0
            if node < view.nodes:
                box = 6 * node
                dx = abs(x - view.boxes[box]) - view.boxes[box + 3] - view.slack
                dy = abs(y - view.boxes[box + 1]) - view.boxes[box + 4] - view.slack
                dz = abs(z - view.boxes[box + 2]) - view.boxes[box + 5] - view.slack
                if max(dx, dy, dz) > wide:
                    node = view.skip[node]
                    continue
                row = view.leaf[node]
                node += 1
                if row < 0 or view.checked[row] & view.bit[link] == 0:
                    continue
                others, extents, which, name = view.row_pose, view.row_extents, row, row
            else:
                others, extents, which, name = view.mover_pose, view.mover_extents, mover, view.rows + mover
                mover += 1
                if view.mover_checked[which] & view.bit[link] == 0:
                    continue
                passed = motion.time[0] - view.since[which]
                growth = view.speed[which] * abs(passed)
                v = 3 * which
                shift = (view.velocity[v] * passed, view.velocity[v + 1] * passed, view.velocity[v + 2] * passed)
            nearest, part = within, -1
            n, p = still, still
            for i in range(view.first[link], view.first[link + 1]):
                rounded = e[EXTENTS * i + 4] + extents[EXTENTS * which + 4] + growth
                gap, direction, point = _gap(
                    f, POSE * i, extents_of(e, i), others, POSE * which, extents_of(extents, which), shift
                )
                if gap - rounded < nearest:
                    nearest, part, n, p = gap - rounded, i, direction, point
            if part >= 0:
                count = _note(body, motion, found, count, nearest, (part, name), n, p, link)
    for subject in range(view.links, body.asked.shape[0]):
        if not body.asked[subject]:
            continue
        one, two = body.pairs[subject - view.links, 1], body.pairs[subject - view.links, 0]
        nearest, part, other = within, -1, -1
        n, p = still, still
        for i in range(view.first[one], view.first[one + 1]):
            for j in range(view.first[two], view.first[two + 1]):
                rounded = e[EXTENTS * i + 4] + e[EXTENTS * j + 4]
                ends = e[EXTENTS * i + 5] + e[EXTENTS * j + 5]
                dx = f[POSE * i + 3] - f[POSE * j + 3]
                dy = f[POSE * i + 7] - f[POSE * j + 7]
                dz = f[POSE * i + 11] - f[POSE * j + 11]
                if math.sqrt(dx * dx + dy * dy + dz * dz) - ends >= nearest:
                    continue
                gap, direction, point = _gap(f, POSE * i, extents_of(e, i), f, POSE * j, extents_of(e, j), still)
                if gap - rounded < nearest:
                    nearest, part, other, n, p = gap - rounded, i, j, direction, point
        if part >= 0:
            count = _note(body, motion, found, count, nearest, (part, -1 - other), n, p, subject)
    return count
