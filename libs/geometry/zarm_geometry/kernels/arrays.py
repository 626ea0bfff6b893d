"""The data of the kernels: a robot and a world in packed arrays, and the view of both that the inner loops use."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.kernels.compiled import inlined
from zarm_geometry.kernels.simd import LANES, pointer
from zarm_trajectory.arrays import Bits, Index, Single

Pointer = Any
"""Pointer to the first element of an array; exists only inside kernels."""

SHAPE = 17
"""Numbers per row of `WorldArrays.shapes`."""
DEEPEST = 32
"""Maximum depth of a bounding volume hierarchy. At 4 children per node it suffices for any number of shapes."""


class RobotArrays(NamedTuple):
    """A robot as the collision kernels read it; links are sorted by the joint that carries them.

    `tree` (dof, 2): the joint that carries each joint, an earlier one, or -1 for the base, and 0 for a prismatic joint;
    `origin` (dof, 3, 4): each joint's frame in that of the joint that carries it, with the joint's axis along z. `link_joint` (links,): the joint that carries a link, -1 for the base;
    `link_first` (links + 1,): the index of its first sphere. `spheres` (n, 4): x, y, z, radius (m) in the frame of that
    joint; `bounds` (links, 4): one sphere that encloses all of a link. `pairs` (m, 2): links that can collide, the one
    nearer to the base first; `common` (m,): the last joint that moves both, -1 for the base; `apart` (m,): the distance
    (m) that their spheres must keep. `reach` (dof, balls): the
    most (m) that a ball's centre moves when the joint moves by 1 rad (1 m if prismatic). The balls are the bounding
    spheres of the links, then the spheres, then zeros up to a multiple of 16. `bit` (links,): see `allowed_collisions`.
    """

    tree: Index
    origin: Single
    link_joint: Index
    link_first: Index
    spheres: Single
    bounds: Single
    pairs: Index
    common: Index
    apart: Single
    reach: Single
    bit: Bits


class WorldArrays(NamedTuple):
    """Obstacles as the collision kernels read them, in a bounding volume hierarchy of axis-aligned boxes. Checks
    inflate every obstacle by `margin` (m).

    `shapes` (n, 17): the base frame in the obstacle's frame (3, 4), row by row; then half extents x, y, z of its core,
    the radius of a disc about z that widens the core, and the rounding added all around. So a cuboid is its extents, a
    sphere a point with a rounding, a capsule a segment with a rounding, and a cylinder a segment with a disc. If the
    radius is negative, the core is the triangle (0, 0), (b, 0), (c, d) in the plane z = 0, and b, c, d replace the half
    extents. `boxes` (m, 6): centre and half extents of the nodes, depth first; `skip` (m,): the node that follows the
    subtree; `leaf` (m,): the obstacle in a leaf, -1 for an inner node. The tree is at most DEEPEST levels deep.
    `checked` (n,): the bits of the links against which an obstacle is checked, see `allowed_collisions`.
    """

    shapes: Single
    boxes: Single
    skip: Index
    leaf: Index
    checked: Bits
    margin: float


class Space(NamedTuple):
    """Robot, world and working memory as counts and pointers, for the inner loops.

    Of the motion being checked: `step` (dof,): how far each joint moves; `motion` (dof + 1, balls): in row k, the most
    (m) that joints k and beyond move each ball along it. `joints` (dof, 16): the configurations being checked; `frames`
    (dof + 1, 192): as `placing` has them; `centers` (balls, 48): x, y and z of each ball in them, if the spheres of the
    link are `placed` (links,). `watched` (links + pairs,): which links are near an obstacle somewhere along the motion,
    and which pairs near each other. `middle` and `half` (65 * 16,): middle and half length of
    intervals of the motion, which goes from 0 to 1; the first 16 are being checked, the rest is a stack of intervals
    yet to be checked. `active`
    and `until` (DEEPEST,): for the current node of the tree and its ancestors, a bit mask of the up to 64 spheres that
    come near it, and the node that follows its subtree.
    """

    dof: int
    links: int
    pairs: int
    balls: int
    nodes: int
    tree: Pointer
    origin: Pointer
    link_joint: Pointer
    link_first: Pointer
    spheres: Pointer
    bounds: Pointer
    pair: Pointer
    common: Pointer
    apart: Pointer
    reach: Pointer
    bit: Pointer
    shapes: Pointer
    boxes: Pointer
    skip: Pointer
    leaf: Pointer
    checked: Pointer
    margin: np.float32
    step: Pointer
    motion: Pointer
    joints: Pointer
    frames: Pointer
    placed: Pointer
    watched: Pointer
    centers: Pointer
    middle: Pointer
    half: Pointer
    active: Pointer
    until: Pointer


class Memory(NamedTuple):
    """Working memory of one kernel call; shapes and meaning as in `Space`."""

    step: Single
    motion: Single
    joints: Single
    frames: Single
    placed: NDArray[np.uint8]
    watched: NDArray[np.uint8]
    centers: Single
    middle: Single
    half: Single
    active: NDArray[np.uint64]
    until: NDArray[np.int64]


def memory(robot: RobotArrays) -> Memory:
    """Allocate the working memory of one kernel call for this robot."""
    dof, balls = robot.reach.shape
    sizes = (
        dof,
        (dof + 1) * balls,
        dof * LANES,
        (dof + 1) * 12 * LANES,
        balls * 3 * LANES,
        65 * LANES,
        65 * LANES,
    )
    step, motion, joints, frames, centers, middle, half = (np.empty(size, np.float32) for size in sizes)
    active, until = np.empty(DEEPEST, np.uint64), np.empty(DEEPEST, np.int64)
    links = len(robot.link_joint)
    placed, watched = np.empty(links, np.uint8), np.empty(links + len(robot.pairs), np.uint8)
    return Memory(step, motion, joints, frames, placed, watched, centers, middle, half, active, until)


@inlined
def space(robot: RobotArrays, world: WorldArrays, memory: Memory) -> Space:
    """The view of a kernel's arguments; it must not outlive them."""
    return Space(
        robot.origin.shape[0],
        robot.link_joint.shape[0],
        robot.pairs.shape[0],
        robot.reach.shape[1],
        world.boxes.shape[0],
        pointer(robot.tree),
        pointer(robot.origin),
        pointer(robot.link_joint),
        pointer(robot.link_first),
        pointer(robot.spheres),
        pointer(robot.bounds),
        pointer(robot.pairs),
        pointer(robot.common),
        pointer(robot.apart),
        pointer(robot.reach),
        pointer(robot.bit),
        pointer(world.shapes),
        pointer(world.boxes),
        pointer(world.skip),
        pointer(world.leaf),
        pointer(world.checked),
        np.float32(world.margin),
        pointer(memory.step),
        pointer(memory.motion),
        pointer(memory.joints),
        pointer(memory.frames),
        pointer(memory.placed),
        pointer(memory.watched),
        pointer(memory.centers),
        pointer(memory.middle),
        pointer(memory.half),
        pointer(memory.active),
        pointer(memory.until),
    )
