"""The search along a motion: its intervals in a heap, and the robot's frames at the samples that are looked at."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.kernels.arrays import DEEPEST
from zarm_geometry.kernels.compiled import brief, inlined
from zarm_geometry.kernels.kinematics import joint_frames
from zarm_trajectory.arrays import Array, Bits, Index

COUNT, OWN, OTHERS, FIRST = 0, 1, 2, 3
"""Columns of `RobotParts.paths`."""


class RobotParts(NamedTuple):
    """A robot's exact shapes.

    `tree` (dof, 2), `origin` (dof, 3, 4): as in `kinematics.joint_frames`. Per link: `offset` (links, 4, 4): its frame in that joint's frame; `around` (links, 4): its
    bounding sphere, x, y, z, radius in its frame; `spread` (links,): the distance (m) from that sphere's centre to the
    farthest point of its parts' cores; `first` (links + 1,): the index of its first part. Per part: `pose` (parts, 4,
    4) in the link's frame; `extents` (parts, 6): four numbers of the core as in `convex`, the rounding, the distance
    from the centre to the farthest point. `pairs` (m, 2): links that can collide, the one nearer to the base first.

    The subjects of a check are the links, each against the world, followed by the pairs. `reach` (subjects, dof): the
    most (m) that a subject moves per rad (per m if prismatic) of each joint; for a pair, the second link relative to
    the first. `paths` (subjects, FIRST + dof): from FIRST on the joints that move a subject, from that of its link
    inwards, for a pair on to that of the first link, then -1; before, their COUNT, and of the joints that move only the
    link, or the second link (OWN), and only the first one (OTHERS), the one nearest to the base, -1 if there is none.
    `bit` (links,) as in `RobotArrays`.
    """

    tree: Index
    origin: Array
    offset: Array
    around: Array
    spread: Array
    first: Index
    pose: Array
    extents: Array
    pairs: Index
    reach: Array
    paths: Index
    bit: Bits


class Obstacles(NamedTuple):
    """A world: `rows` (n, 17) as `WorldArrays.shapes`, without margin, and the tree of `WorldArrays` over them.

    The boxes are in single precision and may be too small by `slack` (m). `checked` (n,) as in `WorldArrays`.
    """

    rows: Array
    boxes: NDArray[np.float32]
    skip: Index
    leaf: Index
    checked: Bits
    slack: float


class ClearanceSearch(NamedTuple):
    """A motion and the state of the search along it.

    `q` (n, dof); `moved` (n, dof): the path length of each joint since the first sample, in rad (m if prismatic).
    `slot` (n,): where the frames of a sample are, -1 if it was not looked at yet; `frames` (n, links, 3, 4), and `axes`
    (n, dof, 6), direction of and a point on each joint's axis, are filled one slot after the other, so that little
    memory is touched. `keys` and `stretches` are a heap of intervals, ordered by a lower bound (m) on their distances;
    the columns of `stretches` are subject, first sample, last sample + 1. `size` (2,): the number of intervals and of
    slots. `joints` (dof, 3, 4), `centers` (parts, 3), `rates` (parts, dof, 2), `active` and `until` (DEEPEST,) are
    working memory.
    """

    q: Array
    moved: Array
    slot: Index
    frames: Array
    axes: Array
    keys: Array
    stretches: Index
    size: NDArray[np.int64]
    joints: Array
    centers: Array
    rates: Array
    active: NDArray[np.uint64]
    until: NDArray[np.int64]


@brief
def search(body: RobotParts, q: Array, asked: NDArray[np.bool_]) -> ClearanceSearch:
    """A search along the motion `q` (n, dof), with no intervals yet; only subjects that are `asked` (subjects,) are
    checked.
    """
    samples, dof = q.shape
    count = 0
    for subject in range(asked.shape[0]):
        count += asked[subject]
    moved = np.zeros((samples, dof))
    for k in range(1, samples):
        for joint in range(dof):
            moved[k, joint] = moved[k - 1, joint] + abs(q[k, joint] - q[k - 1, joint])
    return ClearanceSearch(
        q,
        moved,
        np.full(samples, -1, np.int32),
        np.empty((samples, body.offset.shape[0], 3, 4)),
        np.empty((samples, dof, 6)),
        # The intervals of one subject do not overlap, so the heap never grows larger than this.
        np.empty(samples * count),
        np.empty((samples * count, 3), np.int32),
        np.zeros(2, np.int64),
        np.empty((dof, 3, 4)),
        np.empty((body.pose.shape[0], 3)),
        np.empty((body.pose.shape[0], dof, 2)),
        np.empty(DEEPEST, np.uint64),
        np.empty(DEEPEST, np.int64),
    )


@inlined
def push(search: ClearanceSearch, key: float, subject: int, low: int, high: int) -> None:
    """Add an interval to the heap."""
    i = search.size[0]
    search.size[0] = i + 1
    while i > 0 and search.keys[(i - 1) // 2] > key:
        above = (i - 1) // 2
        search.keys[i] = search.keys[above]
        for c in range(3):
            search.stretches[i, c] = search.stretches[above, c]
        i = above
    search.keys[i] = key
    search.stretches[i, 0], search.stretches[i, 1], search.stretches[i, 2] = subject, low, high


@inlined
def drop_top(search: ClearanceSearch) -> None:
    """Remove the interval with the smallest key from the heap."""
    size = search.size[0] - 1
    search.size[0] = size
    key = search.keys[size]
    i = 0
    while 2 * i + 1 < size:
        below = 2 * i + 1
        if below + 1 < size and search.keys[below + 1] < search.keys[below]:
            below += 1
        if search.keys[below] >= key:
            break
        search.keys[i] = search.keys[below]
        for c in range(3):
            search.stretches[i, c] = search.stretches[below, c]
        i = below
    search.keys[i] = key
    for c in range(3):
        search.stretches[i, c] = search.stretches[size, c]


@inlined
def place(body: RobotParts, search: ClearanceSearch, k: int) -> int:
    """Compute the joint axes and the frames of all links at sample `k`, unless they are known; returns their slot."""
    at = int(search.slot[k])
    if at >= 0:
        return at
    at = int(search.size[1])
    search.size[1] = at + 1
    search.slot[k] = at
    joint_frames(body.tree, body.origin, search.q[k], search.joints)
    for joint in range(search.joints.shape[0]):
        for r in range(3):
            search.axes[at, joint, r], search.axes[at, joint, 3 + r] = (
                search.joints[joint, r, 2],
                search.joints[joint, r, 3],
            )
    for link in range(body.offset.shape[0]):
        j = body.paths[link, FIRST]
        for r in range(3):
            for c in range(4):
                if j < 0:
                    search.frames[at, link, r, c] = body.offset[link, r, c]
                else:
                    value = search.joints[j, r, 3] if c == 3 else 0.0
                    for i in range(3):
                        value += search.joints[j, r, i] * body.offset[link, i, c]
                    search.frames[at, link, r, c] = value
    return at
