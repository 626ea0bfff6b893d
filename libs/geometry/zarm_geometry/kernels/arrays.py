"""What kernels compute on: a robot and a world in packed arrays, and the view of both that the inner loops use."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.kernels.compiled import inlined
from zarm_geometry.kernels.simd import LANES, pointer

Single = NDArray[np.float32]
Index = NDArray[np.int32]
Pointer = Any
"""To the first element of an array, inside kernels only."""

SHAPE = 17
"""Numbers per obstacle, see WorldArrays."""
DEEPEST = 32
"""Levels of a tree of boxes, at most: with 4 children a node those of more shapes than can be counted."""


class RobotArrays(NamedTuple):
    """A robot as the collision kernels read it; links are sorted by the joint that carries them.

    `origin` (dof, 3, 4): frame of each joint in the one before, its axis along z; `revolute` (dof,).
    `link_joint` (links,): the joint that carries the link, -1 for the base; `link_first` (links + 1,): where its spheres
    start. `spheres` (n, 4): x, y, z, radius in the frame of that joint; `bounds` (links, 4): one sphere around them all.
    `pairs` (m, 2): links that can meet, the one nearer to the base first, and `apart` (m,): how far (m) their spheres have to
    keep from each other. `reach` (dof, balls): how far (m) a ball's centre
    moves at most when the joint moves by 1 rad (by 1 m where prismatic); the balls are the bounding spheres of the links,
    then the spheres, then zeros up to a multiple of 16.
    """

    origin: Single
    revolute: NDArray[np.uint8]
    link_joint: Index
    link_first: Index
    spheres: Single
    bounds: Single
    pairs: Index
    apart: Single
    reach: Single


class WorldArrays(NamedTuple):
    """Obstacles as the collision kernels read them, in a tree of axis-aligned boxes; all keep `margin` (m) besides.

    `shapes` (n, 17): the base frame in the obstacle's (3, 4), row by row; then half extents x, y, z of its core, the
    radius of the core about z, and what is added all around. So a cuboid is its extents, a sphere a point, a capsule a
    segment, each with a rounding, and a cylinder a segment with a radius. A radius below 0 marks a triangle: (0, 0), (b, 0),
    (c, d) in the plane z = 0, with b, c, d in place of the half extents, and a rounding.
    `boxes` (m, 6): centre and half extents of the tree's nodes, depth first; `skip` (m,): the node after the subtree;
    `leaf` (m,): the obstacle in a leaf, -1 for an inner node. The tree is no deeper than DEEPEST.
    """

    shapes: Single
    boxes: Single
    skip: Index
    leaf: Index
    margin: float


class Space(NamedTuple):
    """Robot, world and working memory as counts and pointers, for the inner loops.

    Of the edge in hand: `start` and `step` (dof,); `motion` (dof + 1, balls): how far each ball moves along it at most, by
    the joints from this row's on. `centers` (balls, 48): x, y and z in 16 lanes. `middle` and `half` (65 * 16,): stretches
    of the edge, 16 in hand and then a stack of those that are still to be checked. `active` and `until` (DEEPEST,): of the node
    in hand and those above it, which of up to 64 spheres come near, and where its subtree ends.
    """

    dof: int
    links: int
    pairs: int
    balls: int
    nodes: int
    origin: Pointer
    revolute: Pointer
    link_joint: Pointer
    link_first: Pointer
    spheres: Pointer
    bounds: Pointer
    pair: Pointer
    apart: Pointer
    reach: Pointer
    shapes: Pointer
    boxes: Pointer
    skip: Pointer
    leaf: Pointer
    margin: np.float32
    start: Pointer
    step: Pointer
    motion: Pointer
    centers: Pointer
    middle: Pointer
    half: Pointer
    active: Pointer
    until: Pointer


class Memory(NamedTuple):
    """Working memory of one kernel call."""

    start: Single
    step: Single
    motion: Single
    centers: Single
    middle: Single
    half: Single
    active: NDArray[np.uint64]
    until: NDArray[np.int64]


def memory(robot: RobotArrays) -> Memory:
    """Working memory for one call of a kernel for this robot."""
    dof, balls = robot.reach.shape
    sizes = (dof, dof, (dof + 1) * balls, balls * 3 * LANES, 65 * LANES, 65 * LANES)
    start, step, motion, centers, middle, half = (np.empty(size, np.float32) for size in sizes)
    active, until = np.empty(DEEPEST, np.uint64), np.empty(DEEPEST, np.int64)
    return Memory(start, step, motion, centers, middle, half, active, until)


@inlined
def space(robot: RobotArrays, world: WorldArrays, memory: Memory) -> Space:
    """The view of all that a kernel was given; it lives no longer than the kernel's arguments."""
    return Space(
        robot.origin.shape[0],
        robot.link_joint.shape[0],
        robot.pairs.shape[0],
        robot.reach.shape[1],
        world.boxes.shape[0],
        pointer(robot.origin),
        pointer(robot.revolute),
        pointer(robot.link_joint),
        pointer(robot.link_first),
        pointer(robot.spheres),
        pointer(robot.bounds),
        pointer(robot.pairs),
        pointer(robot.apart),
        pointer(robot.reach),
        pointer(world.shapes),
        pointer(world.boxes),
        pointer(world.skip),
        pointer(world.leaf),
        np.float32(world.margin),
        pointer(memory.start),
        pointer(memory.step),
        pointer(memory.motion),
        pointer(memory.centers),
        pointer(memory.middle),
        pointer(memory.half),
        pointer(memory.active),
        pointer(memory.until),
    )
