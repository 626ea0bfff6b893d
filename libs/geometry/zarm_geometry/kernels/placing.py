"""Forward kinematics of 16 configurations at once, in single precision."""

from __future__ import annotations

from zarm_geometry.kernels.arrays import Pointer
from zarm_geometry.kernels.compiled import inlined
from zarm_geometry.kernels.simd import LANES, Lanes, load, magnitude, nearest, splat, store

FRAME = 12 * LANES
"""Numbers per frame: its axes x, y and z, then its origin."""


@inlined
def sine_cosine(x: Lanes) -> tuple[Lanes, Lanes]:
    """Sine and cosine, accurate to 1e-6 for |x| < 10: reduces x to +-pi/2 and evaluates minimax polynomials fitted to
    that interval.
    """
    half_turns = nearest(x * 0.31830988618379067)
    y = x - half_turns * 3.141592653589793
    sign = 1.0 - 2.0 * magnitude(half_turns - 2.0 * nearest(half_turns * 0.5))
    z = y * y
    s = z * 2.6000547e-06 - 1.98066152e-04
    s = z * s + 8.33301729e-03
    s = z * s - 1.66666571e-01
    c = z * 2.31943863e-05 - 1.38559272e-03
    c = z * c + 4.16639895e-02
    c = z * c - 4.99999323e-01
    return sign * (y + y * z * s), sign * (1.0 + z * c)


@inlined
def place_joints(dof: int, tree: Pointer, origin: Pointer, joints: Pointer, frames: Pointer) -> None:
    """Write to `frames` (dof + 1, 12, 16) the frames that move with each joint, after that of the base, at the
    configurations `joints` (dof, 16). `tree` and `origin` as in `RobotArrays`.
    """
    zero, one = splat(0.0), splat(1.0)
    xx, xy, xz = one, zero, zero
    yx, yy, yz = zero, one, zero
    zx, zy, zz = zero, zero, one
    px, py, pz = zero, zero, zero
    m = origin
    for k in range(-1, dof):
        if k >= 0:
            if tree[2 * k] != k - 1:
                at = FRAME * (tree[2 * k] + 1)
                xx, xy, xz = load(frames, at), load(frames, at + LANES), load(frames, at + 2 * LANES)
                yx, yy, yz = load(frames, at + 3 * LANES), load(frames, at + 4 * LANES), load(frames, at + 5 * LANES)
                zx, zy, zz = load(frames, at + 6 * LANES), load(frames, at + 7 * LANES), load(frames, at + 8 * LANES)
                px, py, pz = load(frames, at + 9 * LANES), load(frames, at + 10 * LANES), load(frames, at + 11 * LANES)
            f = 12 * k
            px, py, pz = (
                px + m[f + 3] * xx + m[f + 7] * yx + m[f + 11] * zx,
                py + m[f + 3] * xy + m[f + 7] * yy + m[f + 11] * zy,
                pz + m[f + 3] * xz + m[f + 7] * yz + m[f + 11] * zz,
            )
            ax = m[f] * xx + m[f + 4] * yx + m[f + 8] * zx
            ay = m[f] * xy + m[f + 4] * yy + m[f + 8] * zy
            az = m[f] * xz + m[f + 4] * yz + m[f + 8] * zz
            bx = m[f + 1] * xx + m[f + 5] * yx + m[f + 9] * zx
            by = m[f + 1] * xy + m[f + 5] * yy + m[f + 9] * zy
            bz = m[f + 1] * xz + m[f + 5] * yz + m[f + 9] * zz
            zx, zy, zz = (
                m[f + 2] * xx + m[f + 6] * yx + m[f + 10] * zx,
                m[f + 2] * xy + m[f + 6] * yy + m[f + 10] * zy,
                m[f + 2] * xz + m[f + 6] * yz + m[f + 10] * zz,
            )
            q = load(joints, LANES * k)
            if tree[2 * k + 1] != 0:
                s, c = sine_cosine(q)
                xx, xy, xz = c * ax + s * bx, c * ay + s * by, c * az + s * bz
                yx, yy, yz = c * bx - s * ax, c * by - s * ay, c * bz - s * az
            else:
                xx, xy, xz, yx, yy, yz = ax, ay, az, bx, by, bz
                px, py, pz = px + q * zx, py + q * zy, pz + q * zz
        at = FRAME * (k + 1)
        store(frames, at, xx)
        store(frames, at + LANES, xy)
        store(frames, at + 2 * LANES, xz)
        store(frames, at + 3 * LANES, yx)
        store(frames, at + 4 * LANES, yy)
        store(frames, at + 5 * LANES, yz)
        store(frames, at + 6 * LANES, zx)
        store(frames, at + 7 * LANES, zy)
        store(frames, at + 8 * LANES, zz)
        store(frames, at + 9 * LANES, px)
        store(frames, at + 10 * LANES, py)
        store(frames, at + 11 * LANES, pz)


@inlined
def place_points(
    frames: Pointer, joint: int, points: Pointer, size: int, first: int, last: int, out: Pointer, shift: int
) -> None:
    """Write to `out` (n, 3, 16), from row `shift` + `first` on, where the points `first` to `last` of `points` (n,
    size) are that move with a joint, -1 for the base.
    """
    at = FRAME * (joint + 1)
    xx, xy, xz = load(frames, at), load(frames, at + LANES), load(frames, at + 2 * LANES)
    yx, yy, yz = load(frames, at + 3 * LANES), load(frames, at + 4 * LANES), load(frames, at + 5 * LANES)
    zx, zy, zz = load(frames, at + 6 * LANES), load(frames, at + 7 * LANES), load(frames, at + 8 * LANES)
    px, py, pz = load(frames, at + 9 * LANES), load(frames, at + 10 * LANES), load(frames, at + 11 * LANES)
    for i in range(first, last):
        x, y, z = points[size * i], points[size * i + 1], points[size * i + 2]
        at = 3 * LANES * (shift + i)
        store(out, at, px + x * xx + y * yx + z * zx)
        store(out, at + LANES, py + x * xy + y * yy + z * zy)
        store(out, at + 2 * LANES, pz + x * xz + y * yz + z * zz)
