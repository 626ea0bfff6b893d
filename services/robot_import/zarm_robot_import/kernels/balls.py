"""Balls that contain a surface: their places, and the proof that no point of the surface is outside."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.kernels.compiled import kernel

Array = NDArray[np.float64]


@kernel
def around_triangles(balls: Array, triangles: Array, finest: float) -> tuple[Array, float]:
    """Balls (k, 4) with radii so large that they contain all of the triangles (n, 3, 3), and the most that one grew (m).

    A ball is convex: it contains a triangle once it contains its corners. A triangle that no ball contains is cut into four,
    and where its sides are shorter than `finest` (m) the ball that lacks the least grows. So what is returned is proven.
    """
    balls = balls.copy()
    most = 0.0
    stack = np.empty((256, 3, 3))
    for t in range(len(triangles)):
        stack[0] = triangles[t]
        size = 1
        while size > 0:
            size -= 1
            corner = stack[size].copy()
            lack, at = np.inf, 0
            for j in range(len(balls)):
                if balls[j, 3] <= 0.0:
                    continue
                need = 0.0
                for c in range(3):
                    dx, dy, dz = corner[c, 0] - balls[j, 0], corner[c, 1] - balls[j, 1], corner[c, 2] - balls[j, 2]
                    need = max(need, math.sqrt(dx * dx + dy * dy + dz * dz) - balls[j, 3])
                if need < lack:
                    lack, at = need, j
                if need <= 0.0:
                    break
            if lack <= 0.0:
                continue
            side = 0.0
            for c in range(3):
                e = (c + 1) % 3
                dx, dy, dz = corner[c, 0] - corner[e, 0], corner[c, 1] - corner[e, 1], corner[c, 2] - corner[e, 2]
                side = max(side, dx * dx + dy * dy + dz * dz)
            if side <= finest * finest or size + 4 > len(stack):
                balls[at, 3] += lack + 1e-9
                most = max(most, lack)
                continue
            ab, bc, ca = (corner[0] + corner[1]) / 2, (corner[1] + corner[2]) / 2, (corner[2] + corner[0]) / 2
            stack[size, 0], stack[size + 1, 0], stack[size + 2, 0] = corner[0], corner[1], corner[2]
            stack[size, 1], stack[size, 2] = ab, ca
            stack[size + 1, 1], stack[size + 1, 2] = bc, ab
            stack[size + 2, 1], stack[size + 2, 2] = ca, bc
            stack[size + 3, 0], stack[size + 3, 1], stack[size + 3, 2] = ab, bc, ca
            size += 4
    return balls, most


@kernel
def around_balls(balls: Array, inner: Array, finest: float) -> tuple[Array, float]:
    """Balls (k, 4) with radii so large that their union contains the balls `inner` (n, 4), and the most that one grew (m).

    The cube around each inner ball is cut into eight again and again. A cell is done with once the ball around it is outside of
    the inner ball or within one of the outer; at half a side of `finest` (m) the one that lacks the least grows around it.
    """
    balls = balls.copy()
    most = 0.0
    stack = np.empty((256, 4))
    for t in range(len(inner)):
        stack[0] = inner[t]
        size = 1
        while size > 0:
            size -= 1
            x, y, z, half = stack[size, 0], stack[size, 1], stack[size, 2], stack[size, 3]
            reach = half * math.sqrt(3.0)
            dx, dy, dz = x - inner[t, 0], y - inner[t, 1], z - inner[t, 2]
            if math.sqrt(dx * dx + dy * dy + dz * dz) - reach > inner[t, 3]:
                continue
            lack, at = np.inf, 0
            for j in range(len(balls)):
                dx, dy, dz = x - balls[j, 0], y - balls[j, 1], z - balls[j, 2]
                need = math.sqrt(dx * dx + dy * dy + dz * dz) + reach - balls[j, 3]
                if need < lack:
                    lack, at = need, j
                if need <= 0.0:
                    break
            if lack <= 0.0:
                continue
            if half <= finest or size + 8 > len(stack):
                balls[at, 3] += lack + 1e-9
                most = max(most, lack)
                continue
            for c in range(8):
                stack[size, 0] = x + half * (0.5 if c & 1 else -0.5)
                stack[size, 1] = y + half * (0.5 if c & 2 else -0.5)
                stack[size, 2] = z + half * (0.5 if c & 4 else -0.5)
                stack[size, 3] = half / 2
                size += 1
    return balls, most
