"""Whether a straight edge in joint space is free of collision.

Edges are checked as in Schwarzer, Saha and Latombe, "Adaptive dynamic collision checking for single and multiple
articulated robots in complex environments", 2005: if the links of a configuration are further away from everything than
they can move during an interval of the edge, that whole interval is free. Only intervals that are nearer are
subdivided.
"""

from __future__ import annotations

import math

from zarm_geometry.kernels.arrays import Memory, RobotArrays, Single, Space, WorldArrays, space
from zarm_geometry.kernels.collision import RESOLUTION, check
from zarm_geometry.kernels.compiled import inlined, kernel
from zarm_geometry.kernels.simd import LANES, load, splat, store


@inlined
def set_edge(space: Space, start: Single, end: Single) -> float:
    """Select the edge to check; returns an upper bound (m) on how far any ball moves along it."""
    for k in range(space.dof):
        space.start[k] = start[k]
        space.step[k] = end[k] - start[k]
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


@kernel
def edge_free(space: Space, start: Single, end: Single) -> bool:
    """Whether the edge between two configurations (dof,) is free, to RESOLUTION; if they are equal, whether the
    configuration is.
    """
    farthest = set_edge(space, start, end)
    # The first 16 intervals are being checked, above them is a stack of those yet to be checked. A subdivision at least
    # halves an interval and a round pushes at most 32, so there is room for edges of any length.
    middle, half = space.middle, space.half
    top = 2 * LANES
    for i in range(LANES):
        middle[LANES + i] = (i + 0.5) / LANES
        half[LANES + i] = 0.5 / LANES
    while top > LANES:
        taken = min(top - LANES, LANES)
        for i in range(LANES):  # lanes without an interval of their own repeat the first
            at = top - 1 - (i if i < taken else 0)
            middle[i], half[i] = middle[at], half[at]
        hit, near = check(space, load(middle, 0), load(half, 0))
        if hit != 0:
            return False
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
    return True


@kernel
def path_free(robot: RobotArrays, world: WorldArrays, memory: Memory, path: Single) -> bool:
    """Whether every edge of a path (n, dof) is free; a path of one row is a single configuration."""
    checks = space(robot, world, memory)
    for i in range(max(1, path.shape[0] - 1)):
        if not edge_free(checks, path[i], path[min(i + 1, path.shape[0] - 1)]):
            return False
    return True
