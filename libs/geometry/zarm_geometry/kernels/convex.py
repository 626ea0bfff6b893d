"""Lower and upper bounds on the distance of two convex shapes, in float64; they hold after any number of iterations.

A shape is a row of `WorldArrays.shapes`: a core, and a `rounding` added all around it. The functions here handle cores
only, each given by its extents: half extents x, y, z of a box, and the radius of a disc about z that widens it; or, if
the radius is negative, b, c, d of the triangle (0, 0), (b, 0), (c, d) in the plane z = 0.
"""

from __future__ import annotations

import math

from zarm_geometry.kernels.compiled import inlined

Vector = tuple[float, float, float]
Extents = tuple[float, float, float, float]
Turn = tuple[float, float, float, float, float, float, float, float, float]
"""A rotation matrix, row by row."""

PRECISION = 1e-5
"""Differences of distances below this (m) are ignored."""
_ROUNDS = 100
"""Maximum number of iterations. After that many, the bounds of 1 in 100 random pairs of capsules, cylinders and boxes
have not met, where a third of the pairs are parallel to within a few degrees.
"""


@inlined
def turned(turn: Turn, v: Vector) -> Vector:
    """Rotate a vector out of the frame whose axes are the columns of `turn`."""
    return (
        turn[0] * v[0] + turn[1] * v[1] + turn[2] * v[2],
        turn[3] * v[0] + turn[4] * v[1] + turn[5] * v[2],
        turn[6] * v[0] + turn[7] * v[1] + turn[8] * v[2],
    )


@inlined
def turned_back(turn: Turn, v: Vector) -> Vector:
    """Rotate a vector into the frame whose axes are the columns of `turn`."""
    return (
        turn[0] * v[0] + turn[3] * v[1] + turn[6] * v[2],
        turn[1] * v[0] + turn[4] * v[1] + turn[7] * v[2],
        turn[2] * v[0] + turn[5] * v[1] + turn[8] * v[2],
    )


@inlined
def _segment_point(x: float, y: float, ax: float, ay: float, bx: float, by: float) -> tuple[float, float, float]:
    """The point of the segment from a to b that is nearest to (x, y), and its squared distance from there."""
    ux, uy = bx - ax, by - ay
    t = min(max(((x - ax) * ux + (y - ay) * uy) / (ux * ux + uy * uy), 0.0), 1.0)
    ux, uy = ax + t * ux, ay + t * uy
    return ux, uy, (x - ux) * (x - ux) + (y - uy) * (y - uy)


@inlined
def triangle_point(p: Vector, b: float, c: float, d: float) -> Vector:
    """The point of a triangle that is nearest to `p`: its projection onto the plane if that is inside, otherwise on an
    edge.
    """
    x, y = p[0], p[1]
    if y >= 0.0 and d * x - c * y >= 0.0 and (c - b) * y - d * (x - b) >= 0.0:
        return x, y, 0.0
    near = _segment_point(x, y, 0.0, 0.0, b, 0.0)
    other = _segment_point(x, y, 0.0, 0.0, c, d)
    if other[2] < near[2]:
        near = other
    other = _segment_point(x, y, b, 0.0, c, d)
    if other[2] < near[2]:
        near = other
    return near[0], near[1], 0.0


@inlined
def core_point(p: Vector, core: Extents) -> Vector:
    """The point of a core that is nearest to `p`; `p` itself if it is inside."""
    if core[3] < 0.0:
        return triangle_point(p, core[0], core[1], core[2])
    x = min(max(p[0], -core[0]), core[0])
    y = min(max(p[1], -core[1]), core[1])
    z = min(max(p[2], -core[2]), core[2])
    if core[3] > 0.0:
        across = math.hypot(p[0] - x, p[1] - y)
        part = core[3] / max(across, core[3])
        x, y = x + part * (p[0] - x), y + part * (p[1] - y)
    return x, y, z


@inlined
def core_reach(n: Vector, core: Extents) -> float:
    """Support function: how far a core extends from its centre, or a triangle from its first corner, along the unit
    vector `n`.
    """
    if core[3] < 0.0:
        return max(0.0, n[0] * core[0], n[0] * core[1] + n[1] * core[2])
    return (
        abs(n[0]) * core[0] + abs(n[1]) * core[1] + abs(n[2]) * core[2] + core[3] * math.sqrt(n[0] * n[0] + n[1] * n[1])
    )


@inlined
def core_distance(p: Vector, core: Extents) -> float:
    """Distance of a point to a core; 0 inside."""
    q = core_point(p, core)
    x, y, z = p[0] - q[0], p[1] - q[1], p[2] - q[2]
    return math.sqrt(x * x + y * y + z * z)


@inlined
def separation(n: Vector, c: Vector, turn: Turn, a: Extents, b: Extents) -> float:
    """The width of the slab normal to the unit vector `n` that separates two cores: `b`, and `a` with axes `turn` and
    centre `c` in the frame of `b`.

    It is a lower bound on the distance for every `n`. If it is negative, moving one core by that much along `n`
    separates them.
    """
    back = turned_back(turn, (-n[0], -n[1], -n[2]))
    return n[0] * c[0] + n[1] * c[1] + n[2] * c[2] - core_reach(n, b) - core_reach(back, a)


@inlined
def core_gap(c: Vector, turn: Turn, a: Extents, b: Extents, enough: float) -> tuple[float, float, Vector, Vector]:
    """Lower and upper bound on the distance of core `a`, with axes `turn` and centre `c` in the frame of core `b`, to
    core `b`; and in that frame the unit vector, from `b` to `a`, whose slab proves the lower one, and the last point of
    `a` found, which is the nearest to `b` once the bounds have met.

    Alternating projections find the nearest points of both (Cheney and Goldstein, "Proximity maps for convex sets",
    1959). They are a gradient descent and are accelerated like one (Nesterov's momentum, restarted as by O'Donoghue and
    Candes, "Adaptive restart for accelerated gradient schemes", 2015). The distance of the two points is the upper
    bound, and the slab normal to their difference proves the lower one, so both hold whenever the iteration ends: when
    the bounds meet, when the lower one reaches `enough`, or when the cores are found to overlap. In that case the upper
    bound is 0 and the penetration depth at most minus the lower bound.
    """
    length = math.sqrt(c[0] * c[0] + c[1] * c[1] + c[2] * c[2])
    lower, upper = -math.inf, math.inf
    n = (0.0, 0.0, 1.0)
    if length > 0.0:
        n = (c[0] / length, c[1] / length, c[2] / length)
        lower = separation(n, c, turn, a, b)
    x0, x1, x2 = c
    p0, p1, p2 = c
    d0, d1, d2 = 0.0, 0.0, 0.0
    steps = 0
    for _ in range(_ROUNDS):
        ahead = steps / (steps + 3.0)
        y0, y1, y2 = x0 + ahead * d0, x1 + ahead * d1, x2 + ahead * d2
        q = core_point((y0, y1, y2), b)
        p = turned(turn, core_point(turned_back(turn, (q[0] - c[0], q[1] - c[1], q[2] - c[2])), a))
        p0, p1, p2 = p[0] + c[0], p[1] + c[1], p[2] + c[2]
        n0, n1, n2 = p0 - q[0], p1 - q[1], p2 - q[2]
        apart = math.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
        upper = min(upper, apart)
        if apart < 1e-12:
            break
        towards = (n0 / apart, n1 / apart, n2 / apart)
        bound = separation(towards, c, turn, a, b)
        if bound > lower:
            lower, n = bound, towards
        if lower >= enough or upper - lower <= PRECISION:
            break
        d0, d1, d2 = p0 - x0, p1 - x1, p2 - x2
        uphill = (y0 - p0) * d0 + (y1 - p1) * d1 + (y2 - p2) * d2 > 0.0
        steps = 0 if uphill else steps + 1
        x0, x1, x2 = p0, p1, p2
    return lower, upper, n, (p0, p1, p2)
