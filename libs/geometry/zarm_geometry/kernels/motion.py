"""Whether a timed motion keeps its distance: slabs that stay between two shapes over whole stretches of the motion.

A stretch is what happens from one sample to another. On it each point of the robot stays within `sag` of the chords between
its places at the start, in the middle and at the end. So a slab that separates two shapes at these three moments by `sag` more
than is asked for separates them all the time; nothing between samples is missed. Sags shrink with the square of the time,
and where one is too large, the stretch is cut in two. Stretches are looked at in the order of time, each subject by itself.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.kernels.arrays import Index, Pointer
from zarm_geometry.kernels.clearance import Obstacles, RobotParts
from zarm_geometry.kernels.compiled import inlined, kernel
from zarm_geometry.kernels.convex import Extents, Turn, Vector, core_gap, core_point, core_reach, turned, turned_back
from zarm_geometry.kernels.kinematics import joint_frames
from zarm_geometry.kernels.simd import pointer

Array = NDArray[np.float64]
Box = tuple[float, float, float, float, float, float]
"""The lower corner and the upper one."""
Flags = NDArray[np.uint8]

COARSE = 0.02
"""A stretch with a larger sag (m) is cut in two at once when something is near it."""
CROWD = 48
"""So many obstacles are looked at on a stretch that had better be cut in two."""
KEPT, NEARER, CUT = 0, 1, 2
"""What is found on a stretch."""
POSE = 12
"""Numbers per frame (3, 4)."""
EXTENTS = 6
"""Numbers per solid, see Solids."""


class Solids(NamedTuple):
    """Convex shapes: `pose` (n, 3, 4), and `extents` (n, 6), which are four of the core as in `convex`, the rounding and, of a
    ball, the same again: what is added to it has no other extent.
    """

    pose: Array
    extents: Array


class MotionBody(NamedTuple):
    """A robot: `solids` are its parts and then a ball around each link, in the frames of the joints that carry them.

    `carrier` (solids,): the joint, counted from 1, 0 being the base. The rest is as in `clearance.RobotParts`; `asked`
    (subjects,) are to be looked at, and of a margin keep `room` (subjects,) in m at most.
    """

    origin: Array
    revolute: NDArray[np.bool_]
    carrier: Index
    solids: Solids
    first: Index
    pairs: Index
    reach: Array
    asked: NDArray[np.bool_]
    room: Array


class Movers(NamedTuple):
    """Obstacles that may move: at time t (s) each is displaced by `velocity` (n, 3) times t - `since` (n,).

    Besides, every point of it may be `speed` (n,) times that time away from there. At `since` they are between the corners
    `lower` and `upper` (n, 3).
    """

    solids: Solids
    velocity: Array
    speed: Array
    since: Array
    lower: Array
    upper: Array


class Motion(NamedTuple):
    """A motion of N samples, and what is known of it.

    `time` (N,), `q` (N, dof); `bend` (dof,): how far (rad) a joint may be from the straight line between two samples.
    `frames` (N, solids, 3, 4) hold the robot's solids at the samples that are `placed` (N,). Of the stretches that are
    `measured` (4 N,), numbered as a binary tree from 1 on: `moved` (4 N, dof), by how much each joint moves, and `uneven`
    (4 N, dof), how far it is at most from moving evenly. `joints` (dof + 1, 3, 4): the frame of the base and those of the
    joints at the sample that was placed last.
    """

    time: Array
    q: Array
    bend: Array
    placed: Flags
    frames: Array
    measured: Flags
    moved: Array
    uneven: Array
    joints: Array


def solids(rows: Array) -> Solids:
    """The shapes of rows (n, 17), see `zarm_geometry.rows`."""
    frame = rows[:, :12].reshape(-1, 3, 4)
    turn = frame[:, :, :3].transpose(0, 2, 1)
    pose = np.concatenate([turn, -(turn @ frame[:, :, 3:])], axis=2)
    return Solids(np.ascontiguousarray(pose), np.column_stack([rows[:, 12:], np.full(len(rows), -1.0)]))


def motion_body(parts: RobotParts, asked: NDArray[np.bool_], room: Array) -> MotionBody:
    """A robot for `first_contact`."""
    count = len(parts.link_joint)
    link = np.repeat(np.arange(count), np.diff(parts.first))
    around = np.repeat(np.eye(4)[None], count, axis=0)
    around[:, :3, 3] = parts.around[:, :3]
    pose = np.concatenate([parts.offset[link] @ parts.pose, parts.offset @ around])
    balls = np.zeros((count, EXTENTS))
    balls[:, 4:] = parts.around[:, 3:]
    return MotionBody(
        origin=parts.origin,
        revolute=parts.revolute,
        carrier=(np.concatenate([parts.link_joint[link], parts.link_joint]) + 1).astype(np.int32),
        solids=Solids(np.ascontiguousarray(pose[:, :3]), np.concatenate([parts.extents, balls])),
        first=parts.first,
        pairs=parts.pairs,
        reach=parts.reach,
        asked=asked,
        room=room,
    )


def motion(body: MotionBody, time: Array, q: Array, acceleration: Array) -> Motion:
    """The motion `q` (N, dof) at `time` (N,), N > 1, whose joints accelerate by at most `acceleration` (dof,)."""
    samples, dof = q.shape
    joints = np.zeros((dof + 1, 3, 4))
    joints[0, :, :3] = np.eye(3)
    return Motion(
        time=time,
        q=q,
        bend=acceleration * (float(np.diff(time).max()) ** 2 / 8),
        placed=np.zeros(samples, np.uint8),
        frames=np.empty((samples, *body.solids.pose.shape)),
        measured=np.zeros(4 * samples, np.uint8),
        moved=np.empty((4 * samples, dof)),
        uneven=np.empty((4 * samples, dof)),
        joints=joints,
    )


class View(NamedTuple):
    """Robot, obstacles and motion as counts and pointers, for the inner loops."""

    dof: int
    links: int
    parts: int
    solids: int
    nodes: int
    rows: int
    movers: int
    slack: float
    carrier: Pointer
    pose: Pointer
    extents: Pointer
    first: Pointer
    reach: Pointer
    row_pose: Pointer
    row_extents: Pointer
    alive: Pointer
    boxes: Pointer
    skip: Pointer
    leaf: Pointer
    mover_pose: Pointer
    mover_extents: Pointer
    velocity: Pointer
    speed: Pointer
    since: Pointer
    lower: Pointer
    upper: Pointer
    time: Pointer
    q: Pointer
    bend: Pointer
    frames: Pointer
    measured: Pointer
    moved: Pointer
    uneven: Pointer
    joints: Pointer


@inlined
def view_of(body: MotionBody, world: Obstacles, standing: Solids, alive: Flags, movers: Movers, motion: Motion) -> View:
    """The view of all that a kernel was given; it lives no longer than the kernel's arguments."""
    links = body.first.shape[0] - 1
    return View(
        motion.q.shape[1],
        links,
        body.carrier.shape[0] - links,
        body.carrier.shape[0],
        world.boxes.shape[0],
        standing.pose.shape[0],
        movers.speed.shape[0],
        world.slack,
        pointer(body.carrier),
        pointer(body.solids.pose),
        pointer(body.solids.extents),
        pointer(body.first),
        pointer(body.reach),
        pointer(standing.pose),
        pointer(standing.extents),
        pointer(alive),
        pointer(world.boxes),
        pointer(world.skip),
        pointer(world.leaf),
        pointer(movers.solids.pose),
        pointer(movers.solids.extents),
        pointer(movers.velocity),
        pointer(movers.speed),
        pointer(movers.since),
        pointer(movers.lower),
        pointer(movers.upper),
        pointer(motion.time),
        pointer(motion.q),
        pointer(motion.bend),
        pointer(motion.frames),
        pointer(motion.measured),
        pointer(motion.moved),
        pointer(motion.uneven),
        pointer(motion.joints),
    )


@inlined
def turn_of(frames: Pointer, at: int) -> Turn:
    """The axes of a frame (3, 4) that starts at `frames[at]`."""
    return (
        frames[at], frames[at + 1], frames[at + 2],
        frames[at + 4], frames[at + 5], frames[at + 6],
        frames[at + 8], frames[at + 9], frames[at + 10],
    )  # fmt: skip


@inlined
def extents_of(extents: Pointer, i: int) -> Extents:
    """The core of a solid."""
    at = EXTENTS * i
    return extents[at], extents[at + 1], extents[at + 2], extents[at + 3]


@inlined
def place(view: View, body: MotionBody, motion: Motion, k: int) -> None:
    """All solids at sample `k`."""
    if motion.placed[k] != 0:
        return
    motion.placed[k] = 1
    joint_frames(body.origin, body.revolute, motion.q[k], motion.joints[1:])
    out = POSE * view.solids * k
    for i in range(view.solids):
        joint, mount = POSE * view.carrier[i], POSE * i
        turn = turn_of(view.joints, joint)
        for c in range(4):
            x, y, z = turned(turn, (view.pose[mount + c], view.pose[mount + 4 + c], view.pose[mount + 8 + c]))
            if c == 3:
                x, y, z = x + view.joints[joint + 3], y + view.joints[joint + 7], z + view.joints[joint + 11]
            view.frames[out + mount + c] = x
            view.frames[out + mount + 4 + c] = y
            view.frames[out + mount + 8 + c] = z


@inlined
def _measure(view: View, node: int, first: int, last: int) -> None:
    """How the joints move on a stretch."""
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
    """How far (m) a point of a subject is at most from moving evenly and straight from its start to its end on a stretch.

    With x a point of it and q going evenly from one end to the other by m, |x''| <= sum over joints i, j of |m_i| |m_j| times
    the reach of the outer one of both, and a curve is within an eighth of that from its chord.
    """
    _measure(view, node, first, last)
    sag, inner, curve = 0.0, 0.0, 0.0
    for j in range(view.dof):
        reach = view.reach[view.dof * subject + j]
        if reach > 0.0:
            moved = view.moved[view.dof * node + j]
            sag += reach * view.uneven[view.dof * node + j]
            curve += reach * moved * (moved + 2.0 * inner)
            inner += moved
    return sag + 0.125 * curve


@inlined
def _along(n: Vector, frames: Pointer, at: int, core: Extents, other: Pointer, where: int, shift: Vector) -> float:
    """The smallest n * x of a core, with `n` given in the frame `other[where]` and x seen from its displaced origin."""
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
    """How far (m) one slab keeps two cores apart at three moments at least; a second slab is tried where that is below `need`.

    Their frames start at `frames[a]`, `others[oa]` and so on, and the other one is displaced besides.
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
            gap, _, n = core_gap(center, own, core, other, 2.0 * need)
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
    """What is around a solid of the robot and its places at three samples, `wide` (m) larger on all sides."""
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
def _obstacle_in(view: View, node: int, box: Box) -> int:
    """The first node of the tree from `node` on that has an obstacle in the box, the number of nodes where there is none."""
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
        if row >= 0 and view.alive[row] != 0:
            return node
        node += 1
    return node


@inlined
def _displacement(view: View, mover: int, k: int) -> Vector:
    """Where a mover's velocity has taken it at sample `k`."""
    passed = view.time[k] - view.since[mover]
    at = 3 * mover
    return passed * view.velocity[at], passed * view.velocity[at + 1], passed * view.velocity[at + 2]


@inlined
def _growth(view: View, mover: int, a: int, b: int) -> float:
    """How far a point of a mover may be from there between two samples."""
    since = view.since[mover]
    growth: float = view.speed[mover] * max(abs(view.time[a] - since), abs(view.time[b] - since))
    return growth


@inlined
def _mover_in(view: View, mover: int, a: int, b: int, box: Box) -> int:
    """The first mover from `mover` on that comes into the box between two samples, the number of movers where none does."""
    while mover < view.movers:
        early, late, growth = _displacement(view, mover, a), _displacement(view, mover, b), _growth(view, mover, a, b)
        at = 3 * mover
        if not (
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
    """Whether a link keeps the margin on a stretch, KEPT or NEARER; and then the part and obstacle that do not. CUT where that is better
    asked of both halves.

    Obstacles are numbered as rows of the world, and then the movers.
    """
    ball = view.parts + link
    radius = view.extents[EXTENTS * ball + 4]
    box = _box(view, ball, a, m, b, sag + margin)
    first, first_mover = _obstacle_in(view, 0, box), _mover_in(view, 0, a, b, box)
    if first == view.nodes and first_mover == view.movers:
        return KEPT, 0, 0
    whole = b == a + 1
    if sag > COARSE and not whole:
        return CUT, 0, 0
    # A stretch on which a link moves far, for its size, is beside more obstacles than its halves together.
    span = max(box[3] - box[0], box[4] - box[1], box[5] - box[2]) - 2.0 * (radius + margin)
    long = not whole and span > 0.25 * radius
    crowd = 0
    size = POSE * view.solids
    for i in range(view.first[link], view.first[link + 1]):
        core = extents_of(view.extents, i)
        away = sag + view.extents[EXTENTS * i + 4]
        box = _box(view, i, a, m, b, sag + margin)
        fa, fm, fb = size * a + POSE * i, size * m + POSE * i, size * b + POSE * i
        node, mover = _obstacle_in(view, first, box), _mover_in(view, first_mover, a, b, box)
        while node < view.nodes or mover < view.movers:
            early = middle = late = (0.0, 0.0, 0.0)
            growth = 0.0
            if node < view.nodes:
                which = name = view.leaf[node]
                others, extents = view.row_pose, view.row_extents
                node = _obstacle_in(view, node + 1, box)
            else:
                which, name = mover, view.rows + mover
                others, extents = view.mover_pose, view.mover_extents
                early, middle, late = (
                    _displacement(view, mover, a),
                    _displacement(view, mover, m),
                    _displacement(view, mover, b),
                )
                growth = _growth(view, mover, a, b)
                mover = _mover_in(view, mover + 1, a, b, box)
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
    """The same of two links; a part of `other` is -1 minus its index."""
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
    alive: Flags,
    movers: Movers,
    motion: Motion,
    margin: float,
) -> tuple[int, int, int]:
    """The first sample after which it is not proven that all keep `margin` (m), or their room, the number of samples - 1 where all is.

    Then the part and what it comes too near to: a row of the world, after those the movers, or -1 minus another part. `standing` are
    the world's shapes, of which only those that are `alive` (n,) count.
    """
    view = view_of(body, world, standing, alive, movers, motion)
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
                found, i, other = _against_link(view, one, two, a, m, b, sag, min(margin, body.room[subject]))
            if found == KEPT:
                continue
            if m == a:
                until, part, near = a, i, other
                break
            stack[top, 0], stack[top, 1], stack[top, 2] = 2 * node + 1, m, b
            stack[top + 1, 0], stack[top + 1, 1], stack[top + 1, 2] = 2 * node, a, m
            top += 2
    return until, part, near
