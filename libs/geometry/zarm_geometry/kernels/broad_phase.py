"""The broad phase of the exact check: which subjects may come near anything, in which intervals of a motion.

16 intervals at once are looked at in single precision, on balls that contain the exact shapes (Schwarzer, Saha and
Latombe's bound, as in `clearance`). It is conservative: what it leaves out is farther away than asked.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.kernels.arrays import SHAPE, Pointer
from zarm_geometry.kernels.clearance_search import OTHERS, OWN, ClearanceSearch, Obstacles, RobotParts, push
from zarm_geometry.kernels.collision import in_box, squared_distance
from zarm_geometry.kernels.compiled import inlined
from zarm_geometry.kernels.placing import FRAME, place_joints, place_points
from zarm_geometry.kernels.simd import (
    LANES,
    Lanes,
    below,
    load,
    lowest_bit,
    pointer,
    root,
    smaller,
    splat,
    store,
    where_positive,
)
from zarm_trajectory.arrays import Index, Single

MIN_SAMPLES = 32
"""Motions of fewer samples are not worth a broad phase."""
BLOCKS = 256
"""Intervals that a longer motion is divided into, a multiple of 16; fewer if it has fewer samples."""
ERROR = 1e-4
"""Added to the distance asked for (m), because single precision is not exact: its errors are far smaller within 10 m,
and `Obstacles.slack` grows with larger distances.
"""
_BALLS = 64
"""Balls of a link that descend the tree together."""


class Cover(NamedTuple):
    """Balls that contain a robot's exact shapes, sorted by link.

    `balls` (n, 4): x, y, z, radius (m) in the frame of the joint that carries them; `first` (links + 1,): the index of
    a link's first ball, `link_joint` (links,) the joint that carries it; `around` (links, 5): a ball that encloses those of a link, and the distance from its centre to
    the farthest of their centres. `tree` and `origin` as in `RobotArrays`.
    """

    tree: Index
    origin: Single
    link_joint: Index
    balls: Single
    first: Index
    around: Single


class Batch(NamedTuple):
    """Working memory for 16 intervals.

    `angle` (dof, 16): the joints in the middle of each interval; `way` (dof, 16): the most that each joint moves from
    there to one of its ends; `frames` (dof + 1, 192): as in `placing`; `centers` (balls, 3, 16), `around` (links, 3,
    16): centres of the balls, and of those that enclose a link's; `travel` (links, dof, 16): how far a link moves by
    this joint and those beyond it; `least` (16,): the distances found.
    """

    angle: Single
    way: Single
    frames: Single
    centers: Single
    around: Single
    travel: Single
    least: Single


@inlined
def make_batch(cover: Cover) -> Batch:
    """Allocate the working memory."""
    dof, links, balls = cover.origin.shape[0], cover.around.shape[0], cover.balls.shape[0]
    return Batch(
        np.empty(dof * LANES, np.float32),
        np.empty(dof * LANES, np.float32),
        np.empty((dof + 1) * FRAME, np.float32),
        np.empty(3 * balls * LANES, np.float32),
        np.empty(3 * links * LANES, np.float32),
        np.empty(links * dof * LANES, np.float32),
        np.empty(LANES, np.float32),
    )


class _View(NamedTuple):
    """Robot, world and a `Batch` as counts and pointers, which must not outlive them."""

    dof: int
    links: int
    nodes: int
    tree: Pointer
    origin: Pointer
    link_joint: Pointer
    first: Pointer
    balls: Pointer
    bounds: Pointer
    shapes: Pointer
    boxes: Pointer
    skip: Pointer
    leaf: Pointer
    checked: Pointer
    bit: Pointer
    angle: Pointer
    way: Pointer
    frames: Pointer
    centers: Pointer
    around: Pointer
    travel: Pointer
    active: Pointer
    until: Pointer


@inlined
def _place(view: _View) -> None:
    """Place the joints, the balls and the balls around links for the joints in `angle`."""
    place_joints(view.dof, view.tree, view.origin, view.angle, view.frames)
    for link in range(view.links):
        joint = view.link_joint[link]
        place_points(view.frames, joint, view.bounds, 5, link, link + 1, view.around, 0)
        place_points(view.frames, joint, view.balls, 4, view.first[link], view.first[link + 1], view.centers, 0)


@inlined
def _measure_travel(view: _View, link: int) -> None:
    """Write upper bounds (m) on how far a link's balls move from the middle of an interval to any of its samples.

    A joint moves them by at most its rotation times their distance from its axis, which joints further out may increase
    by as much as they move them.
    """
    at = 3 * link * LANES
    x, y, z = load(view.around, at), load(view.around, at + LANES), load(view.around, at + 2 * LANES)
    spread = view.bounds[5 * link + 4]
    travel = splat(0.0)
    joint = view.link_joint[link]
    while joint >= 0:
        way = load(view.way, joint * LANES)
        if view.tree[2 * joint + 1] != 0:
            a = FRAME * (joint + 1) + 6 * LANES  # the joint's axis, and behind it a point on it
            ux, uy, uz = load(view.frames, a), load(view.frames, a + LANES), load(view.frames, a + 2 * LANES)
            dx = x - load(view.frames, a + 3 * LANES)
            dy = y - load(view.frames, a + 4 * LANES)
            dz = z - load(view.frames, a + 5 * LANES)
            cx, cy, cz = dy * uz - dz * uy, dz * ux - dx * uz, dx * uy - dy * ux
            arm = root(cx * cx + cy * cy + cz * cz) + spread
            travel = travel + way * (arm + travel)
        else:
            travel = travel + way
        store(view.travel, (link * view.dof + joint) * LANES, travel)
        joint = view.tree[2 * joint]


@inlined
def _reach(clearance: Lanes, travel: Lanes, more: float) -> Lanes:
    """`clearance` and `more` (m), or 0 in the lanes that are known to be near: where the clearance is no more than `travel`."""
    return where_positive(clearance - travel, clearance + more)


@inlined
def _to_world(view: _View, link: int, travel: Lanes, clearance: Lanes) -> Lanes:
    """The distance (m) of a link to the world in the middle of each interval, if it is less than `clearance`.

    Lanes in which it is found to be less than `travel` are not looked at further.
    """
    at = 3 * link * LANES
    x, y, z = load(view.around, at), load(view.around, at + LANES), load(view.around, at + 2 * LANES)
    for first in range(view.first[link], view.first[link + 1], _BALLS):
        count = min(view.first[link + 1] - first, _BALLS)
        view.active[0] = ~np.uint64(0) >> np.uint64(_BALLS - count)
        view.until[0] = view.nodes
        level, node = 0, 0
        while node < view.nodes:
            while node >= view.until[level]:
                level -= 1
            if in_box(view.boxes, node, x, y, z, _reach(clearance, travel, view.bounds[5 * link + 3])) == 0:
                node = view.skip[node]
                continue
            active, reached = view.active[level], np.uint64(0)
            while active != 0:
                ball = first + lowest_bit(active)
                bit = active & (~active + np.uint64(1))
                active ^= bit
                at = 3 * ball * LANES
                bx, by, bz = load(view.centers, at), load(view.centers, at + LANES), load(view.centers, at + 2 * LANES)
                if in_box(view.boxes, node, bx, by, bz, _reach(clearance, travel, view.balls[4 * ball + 3])) != 0:
                    reached |= bit
            if reached == 0:
                node = view.skip[node]
                continue
            row = view.leaf[node]
            node += 1
            if row < 0:
                level += 1
                view.active[level], view.until[level] = reached, view.skip[node - 1]
                continue
            if view.checked[row] & view.bit[link] == 0:
                continue
            shape = SHAPE * row
            while reached != 0:
                ball = first + lowest_bit(reached)
                reached &= reached - np.uint64(1)
                at = 3 * ball * LANES
                bx, by, bz = load(view.centers, at), load(view.centers, at + LANES), load(view.centers, at + 2 * LANES)
                apart = squared_distance(view.shapes, shape, bx, by, bz)
                radii = view.balls[4 * ball + 3] + view.shapes[shape + 16]
                reach = _reach(clearance, travel, radii)
                if below(apart, reach * reach) != 0:
                    clearance = smaller(clearance, root(apart) - radii)
    return clearance


@inlined
def _to_each_other(view: _View, one: int, other: int, travel: Lanes, clearance: Lanes) -> Lanes:
    """The same for two links."""
    at = 3 * one * LANES
    ax, ay, az = load(view.around, at), load(view.around, at + LANES), load(view.around, at + 2 * LANES)
    at = 3 * other * LANES
    x, y, z = ax - load(view.around, at), ay - load(view.around, at + LANES), az - load(view.around, at + 2 * LANES)
    beyond = view.bounds[5 * one + 3]
    reach = clearance + (beyond + view.bounds[5 * other + 3])
    if below(x * x + y * y + z * z, reach * reach) == 0:
        return clearance
    for j in range(view.first[other], view.first[other + 1]):
        at = 3 * j * LANES
        bx, by, bz = load(view.centers, at), load(view.centers, at + LANES), load(view.centers, at + 2 * LANES)
        radius = view.balls[4 * j + 3]
        x, y, z = ax - bx, ay - by, az - bz
        reach = _reach(clearance, travel, beyond + radius)
        if below(x * x + y * y + z * z, reach * reach) == 0:
            continue
        for i in range(view.first[one], view.first[one + 1]):
            at = 3 * i * LANES
            x, y, z = (
                load(view.centers, at) - bx,
                load(view.centers, at + LANES) - by,
                load(view.centers, at + 2 * LANES) - bz,
            )
            apart = x * x + y * y + z * z
            radii = view.balls[4 * i + 3] + radius
            reach = _reach(clearance, travel, radii)
            if below(apart, reach * reach) != 0:
                clearance = smaller(clearance, root(apart) - radii)
    return clearance


@inlined
def push_near(
    body: RobotParts,
    cover: Cover,
    world: Obstacles,
    shapes: Single,
    search: ClearanceSearch,
    asked: NDArray[np.bool_],
    enough: float,
    batch: Batch,
) -> None:
    """Add to the heap of a course the intervals in which a subject that is `asked` may come closer than `enough` (m) to
    what it is checked against.

    `shapes` (n, 17): the rows of `world` in single precision. The caller allocates the `batch`: an array of which only
    a pointer is used is freed at once.
    """
    samples, dof = search.q.shape
    links, angle, way, least = cover.around.shape[0], batch.angle, batch.way, batch.least
    view = _View(
        dof,
        links,
        world.boxes.shape[0],
        pointer(cover.tree),
        pointer(cover.origin),
        pointer(cover.link_joint),
        pointer(cover.first),
        pointer(cover.balls),
        pointer(cover.around),
        pointer(shapes),
        pointer(world.boxes),
        pointer(world.skip),
        pointer(world.leaf),
        pointer(world.checked),
        pointer(body.bit),
        pointer(batch.angle),
        pointer(batch.way),
        pointer(batch.frames),
        pointer(batch.centers),
        pointer(batch.around),
        pointer(batch.travel),
        pointer(search.active),
        pointer(search.until),
    )
    error = ERROR + 10.0 * world.slack
    wanted = np.float32(enough + error)
    blocks = min(BLOCKS, samples - samples % LANES)
    for first in range(0, blocks, LANES):
        for lane in range(LANES):
            low, high = (first + lane) * samples // blocks, (first + lane + 1) * samples // blocks
            k = (low + high) // 2
            for joint in range(dof):
                q = search.q[k, joint]
                if cover.tree[joint, 1] != 0:
                    q -= 2.0 * math.pi * round(q / (2.0 * math.pi))
                angle[joint * LANES + lane] = q
                moved = search.moved[k, joint]
                before, after = moved - search.moved[low, joint], search.moved[high - 1, joint] - moved
                way[joint * LANES + lane] = max(before, after)
        _place(view)
        for link in range(links):
            _measure_travel(view, link)
        for subject in range(asked.shape[0]):
            if not asked[subject]:
                continue
            one, other, travel = subject, -1, splat(0.0)
            if subject >= links:
                other, one = body.pairs[subject - links, 0], body.pairs[subject - links, 1]
                if body.paths[subject, OTHERS] >= 0:
                    travel = load(view.travel, (other * dof + body.paths[subject, OTHERS]) * LANES)
            if body.paths[subject, OWN] >= 0:
                travel = travel + load(view.travel, (one * dof + body.paths[subject, OWN]) * LANES)
            clearance = travel + wanted
            if subject < links:
                found = _to_world(view, subject, travel, clearance)
            else:
                found = _to_each_other(view, one, other, travel, clearance)
            near = below(found, clearance)
            if near == 0:
                continue
            store(pointer(least), 0, found - travel)
            for lane in range(LANES):
                if (near >> np.uint32(lane)) & np.uint32(1):
                    low, high = (first + lane) * samples // blocks, (first + lane + 1) * samples // blocks
                    bound = least[lane] - error if least[lane] > 0.0 else -np.inf
                    push(search, bound, subject, low, high)
