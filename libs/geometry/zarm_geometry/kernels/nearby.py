"""The distances of a robot to everything near one configuration, and their gradients by the joints."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.kernels.arrays import Pointer
from zarm_geometry.kernels.clearance_search import COUNT, FIRST, OWN, Obstacles
from zarm_geometry.kernels.compiled import inlined, kernel
from zarm_geometry.kernels.convex import Extents, Vector, core_gap, separation, turned, turned_back
from zarm_geometry.kernels.motion import (
    EXTENTS,
    POSE,
    Flags,
    Motion,
    MotionBody,
    Movers,
    Solids,
    extents_of,
    place,
    turn_of,
    view_of,
)

Array = NDArray[np.float64]

GRADIENT = 3
"""The column in which the gradient starts in a row of `near`."""


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
    gap, _, n = core_gap(c, own, core, other, math.inf)
    if gap < 0.0:  # they overlap: take the shortest way out along the axes of either core
        for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (u0, u1, u2), (v0, v1, v2), (w0, w1, w2)):
            sign = 1.0 if axis[0] * c[0] + axis[1] * c[1] + axis[2] * c[2] >= 0.0 else -1.0
            out = (sign * axis[0], sign * axis[1], sign * axis[2])
            apart = separation(out, c, own, core, other)
            if apart > gap:
                gap, n = apart, out
    n = turned(turn, n)
    d0, d1, d2 = turned_back(mine, n)
    flat = math.sqrt(d0 * d0 + d1 * d1)
    disc = core[3] / flat if flat > 1e-9 else 0.0
    # If an edge or a face is parallel to the slab, take its middle.
    s0, s1, s2 = _side(d0) * core[0] + disc * d0, _side(d1) * core[1] + disc * d1, _side(d2) * core[2]
    s0, s1, s2 = turned(mine, (-s0, -s1, -s2))
    return gap, n, (frames[at + 3] + s0, frames[at + 7] + s1, frames[at + 11] + s2)


@inlined
def _side(value: float) -> float:
    return 1.0 if value > 1e-3 else -1.0 if value < -1e-3 else 0.0


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
    alive: Flags,
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
    view = view_of(body, world, standing, alive, movers, motion)
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
                if row < 0 or view.alive[row] == 0:
                    continue
                others, extents, which, name = view.row_pose, view.row_extents, row, row
            else:
                others, extents, which, name = view.mover_pose, view.mover_extents, mover, view.rows + mover
                mover += 1
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
