"""Whether motions are free of collision, and straight edges in joint space in particular.

They are checked as in Schwarzer, Saha and Latombe, "Adaptive dynamic collision checking for single and multiple
articulated robots in complex environments", 2005: if the links of a configuration are further away from everything than
they can move during an interval of the motion, that whole interval is free. Only intervals that are nearer are
subdivided.
"""

from __future__ import annotations

import math

from zarm_geometry.kernels.arrays import Memory, RobotArrays, Space, WorldArrays, space
from zarm_geometry.kernels.collision import RESOLUTION, check
from zarm_geometry.kernels.compiled import inlined, kernel
from zarm_geometry.kernels.simd import LANES, Mask, load, splat, store
from zarm_trajectory.arrays import Single


@inlined
def set_motion(space: Space) -> float:
    """Compute `Space.motion` for joints that move by up to `Space.step`; returns the most (m) that any ball moves."""
    for ball in range(0, space.balls, LANES):
        moved = splat(0.0)
        store(space.motion, space.dof * space.balls + ball, moved)
        for k in range(space.dof - 1, -1, -1):
            moved = moved + abs(space.step[k]) * load(space.reach, k * space.balls + ball)
            store(space.motion, k * space.balls + ball, moved)
    farthest = 0.0
    for link in range(space.links):
        farthest = max(farthest, space.motion[link])
    return farthest


@inlined
def divide(space: Space) -> int:
    """Divide the motion into 16 intervals that are to be checked; returns the top of their stack.

    The first 16 of `Space.middle` and `Space.half` are being checked, above them is the stack.
    """
    for i in range(LANES):
        space.middle[LANES + i] = (i + 0.5) / LANES
        space.half[LANES + i] = 0.5 / LANES
    return 2 * LANES


@inlined
def take(space: Space, top: int) -> int:
    """Take up to 16 intervals from the stack, to be checked; returns their number."""
    taken = min(top - LANES, LANES)
    for i in range(LANES):  # lanes without an interval of their own repeat the first
        at = top - 1 - (i if i < taken else 0)
        space.middle[i], space.half[i] = space.middle[at], space.half[at]
    return taken


@inlined
def subdivide(space: Space, top: int, taken: int, near: Mask, farthest: float) -> int:
    """Subdivide those of the `taken` intervals that are `near` something, down to RESOLUTION; returns the stack's new
    top.

    A subdivision at least halves an interval and a round pushes at most 32, so there is room for motions of any length.
    """
    middle, half = space.middle, space.half
    top -= taken
    count = 0
    for i in range(taken):
        count += (near >> i) & 1
    for i in range(taken):
        needed = math.ceil(2.0 * half[i] * farthest / RESOLUTION)
        if (near >> i) & 1 and needed > 1:
            parts = min(needed, max(2, LANES // count))
            part = half[i] / parts
            for p in range(parts):
                middle[top] = middle[i] - half[i] + (2 * p + 1) * part
                half[top] = part
                top += 1
    return top


@kernel
def edge_free(space: Space, start: Single, end: Single) -> bool:
    """Whether the edge between two configurations (dof,) is free, to RESOLUTION; if they are equal, whether the
    configuration is.
    """
    for k in range(space.dof):
        space.step[k] = end[k] - start[k]
    farthest = set_motion(space)
    top, whole = divide(space), True
    while top > LANES:
        taken = take(space, top)
        middle = load(space.middle, 0)
        for k in range(space.dof):
            store(space.joints, LANES * k, start[k] + space.step[k] * middle)
        hit, near = check(space, whole)
        if hit != 0:
            return False
        whole = False
        top = subdivide(space, top, taken, near, farthest)
    return True


@kernel
def path_free(robot: RobotArrays, world: WorldArrays, memory: Memory, path: Single) -> bool:
    """Whether every edge of a path (n, dof) is free; a path of one row is a single configuration."""
    checks = space(robot, world, memory)
    for i in range(max(1, path.shape[0] - 1)):
        if not edge_free(checks, path[i], path[min(i + 1, path.shape[0] - 1)]):
            return False
    return True
