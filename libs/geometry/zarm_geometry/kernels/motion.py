"""A timed motion of the robot among standing and moving obstacles, packed for the kernels that check it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.kernels.arrays import Pointer
from zarm_geometry.kernels.clearance_search import FIRST, Obstacles, RobotParts
from zarm_geometry.kernels.compiled import brief, inlined
from zarm_geometry.kernels.convex import Extents, Turn, turned
from zarm_geometry.kernels.kinematics import joint_frames
from zarm_geometry.kernels.simd import pointer
from zarm_trajectory.arrays import Array, Bits, Index

Flags = NDArray[np.uint8]

POSE = 12
"""Numbers per frame (3, 4)."""
EXTENTS = 6
"""Numbers per solid, see Solids."""


class Solids(NamedTuple):
    """Convex shapes: `pose` (n, 3, 4), and `extents` (n, 6): four numbers of the core as in `convex`, the rounding, and
    for the robot's solids the distance (m) from the centre to the farthest point, which for a ball equals the rounding;
    -1 for obstacles.
    """

    pose: Array
    extents: Array


class MotionBody(NamedTuple):
    """A robot: `solids` are its parts, followed by one bounding ball per link, in the frames of the joints that carry
    them.

    `carrier` (solids,): that joint, counted from 1; 0 is the base. `asked` (subjects,): the subjects to check; `kept_margin`
    (subjects,): the largest margin (m) that each can keep. The rest is as in `clearance.RobotParts`.
    """

    tree: Index
    origin: Array
    carrier: Index
    solids: Solids
    first: Index
    pairs: Index
    reach: Array
    paths: Index
    asked: NDArray[np.bool_]
    kept_margin: Array
    bit: Bits


class Movers(NamedTuple):
    """Obstacles that may move: at time t (s) each is displaced by `velocity` (n, 3) in m/s times t - `since` (n,).

    In addition, each of its points may be up to `speed` (n,) in m/s times the elapsed time away from there. At `since`
    they are between the corners `lower` and `upper` (n, 3). `checked` (n,) as in `WorldArrays`.
    """

    solids: Solids
    velocity: Array
    speed: Array
    since: Array
    lower: Array
    upper: Array
    checked: Bits


class Motion(NamedTuple):
    """A motion of N samples, and what has been computed about it so far.

    `time` (N,), `q` (N, dof); `bend` (dof,): the most (rad) that a joint deviates from the straight line between two
    neighbouring samples. `frames` (N, solids, 3, 4): the robot's solids, at the samples that are `placed` (N,).
    Intervals are numbered as a binary tree starting at 1; for those that are `measured` (4 N,), `moved` (4 N, dof) is
    how far each joint moves and `uneven` (4 N, dof) the most that it deviates from uniform motion. `joints` (dof + 1,
    3, 4): the frames of the base and the joints at the sample placed last.
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
    """The shapes of rows (n, 17), see `zarm_geometry.packed_shapes`."""
    frame = rows[:, :12].reshape(-1, 3, 4)
    turn = frame[:, :, :3].transpose(0, 2, 1)
    pose = np.concatenate([turn, -(turn @ frame[:, :, 3:])], axis=2)
    return Solids(np.ascontiguousarray(pose), np.column_stack([rows[:, 12:], np.full(len(rows), -1.0)]))


NO_MOVERS = Movers(
    solids(np.zeros((0, 17))),
    np.zeros((0, 3)),
    np.zeros(0),
    np.zeros(0),
    np.zeros((0, 3)),
    np.zeros((0, 3)),
    np.zeros(0, np.uint64),
)


def motion_body(parts: RobotParts, asked: NDArray[np.bool_], kept_margin: Array) -> MotionBody:
    """Pack a robot for `first_contact`."""
    count = len(parts.offset)
    link_joint = parts.paths[:count, FIRST]
    link = np.repeat(np.arange(count), np.diff(parts.first))
    around = np.repeat(np.eye(4)[None], count, axis=0)
    around[:, :3, 3] = parts.around[:, :3]
    pose = np.concatenate([parts.offset[link] @ parts.pose, parts.offset @ around])
    balls = np.zeros((count, EXTENTS))
    balls[:, 4:] = parts.around[:, 3:]
    return MotionBody(
        tree=parts.tree,
        origin=parts.origin,
        carrier=(np.concatenate([link_joint[link], link_joint]) + 1).astype(np.int32),
        solids=Solids(np.ascontiguousarray(pose[:, :3]), np.concatenate([parts.extents, balls])),
        first=parts.first,
        pairs=parts.pairs,
        reach=parts.reach,
        paths=parts.paths,
        asked=asked,
        kept_margin=kept_margin,
        bit=parts.bit,
    )


@brief
def motion(body: MotionBody, time: Array, q: Array, acceleration: Array) -> Motion:
    """The motion `q` (N, dof) at `time` (N,), N > 1, whose joints accelerate by at most `acceleration` (dof,) in
    rad/s^2.
    """
    samples, dof = q.shape
    joints = np.zeros((dof + 1, 3, 4))
    for i in range(3):
        joints[0, i, i] = 1.0
    longest = 0.0
    for k in range(1, samples):
        longest = max(longest, time[k] - time[k - 1])
    return Motion(
        time,
        q,
        acceleration * (longest**2 / 8),
        np.zeros(samples, np.uint8),
        np.empty((samples, body.carrier.shape[0], 3, 4)),
        np.zeros(4 * samples, np.uint8),
        np.empty((4 * samples, dof)),
        np.empty((4 * samples, dof)),
        joints,
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
    paths: Pointer
    bit: Pointer
    row_pose: Pointer
    row_extents: Pointer
    checked: Pointer
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
    mover_checked: Pointer
    time: Pointer
    q: Pointer
    bend: Pointer
    frames: Pointer
    measured: Pointer
    moved: Pointer
    uneven: Pointer
    joints: Pointer


@inlined
def view_of(
    body: MotionBody, world: Obstacles, standing: Solids, checked: Bits, movers: Movers, motion: Motion
) -> View:
    """The view of a kernel's arguments; it must not outlive them."""
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
        pointer(body.paths),
        pointer(body.bit),
        pointer(standing.pose),
        pointer(standing.extents),
        pointer(checked),
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
        pointer(movers.checked),
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
    """The axes of the frame (3, 4) that starts at `frames[at]`."""
    return (
        frames[at], frames[at + 1], frames[at + 2],
        frames[at + 4], frames[at + 5], frames[at + 6],
        frames[at + 8], frames[at + 9], frames[at + 10],
    )  # fmt: skip


@inlined
def extents_of(extents: Pointer, i: int) -> Extents:
    """The extents of a solid's core."""
    at = EXTENTS * i
    return extents[at], extents[at + 1], extents[at + 2], extents[at + 3]


@inlined
def place(view: View, body: MotionBody, motion: Motion, k: int) -> None:
    """Compute the frames of all solids at sample `k`, unless they are known."""
    if motion.placed[k] != 0:
        return
    motion.placed[k] = 1
    joint_frames(body.tree, body.origin, motion.q[k], motion.joints[1:])
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
