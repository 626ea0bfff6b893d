"""16 descents of inverse kinematics at once, in single precision: where `inverse.descend` begins, close to solutions."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from zarm_geometry.kernels.arrays import Pointer, RobotArrays
from zarm_geometry.kernels.compiled import inlined
from zarm_geometry.kernels.placing import FRAME, place_joints
from zarm_geometry.kernels.simd import (
    LANES,
    Lanes,
    larger,
    load,
    nearest,
    pointer,
    root,
    smaller,
    splat,
    store,
    where_positive,
)
from zarm_trajectory.arrays import Single

TURN = 2.0 * math.pi
LEAST = 1e-6
"""Least damping; single precision needs more than double."""
PIVOT = 1e-7
"""Least square of a pivot: what is smaller is rounding."""
HALF_TURN = 1e-3
"""Least squared cosine of half the remaining angle: beyond, its axis is rounding."""


class Descents(NamedTuple):
    """Working memory, for 16 configurations each.

    `joints` (dof, 16): where they are; `frames` (dof + 1, 192): as in `placing`; `jacobian` (6, dof, 16); `normal` (21,
    16): the lower triangle of the normal equations; `error` (6, 16): the twist to the target, in m and rad; `left` (2,
    16): the squares of its two lengths.
    """

    joints: Single
    frames: Single
    jacobian: Single
    normal: Single
    error: Single
    left: Single


@inlined
def make_descents(dof: int) -> Descents:
    """Allocate the working memory."""
    return Descents(
        np.empty((dof, LANES), np.float32),
        np.empty((dof + 1, FRAME), np.float32),
        np.empty((6, dof, LANES), np.float32),
        np.empty((21, LANES), np.float32),
        np.empty((6, LANES), np.float32),
        np.empty((2, LANES), np.float32),
    )


@inlined
def _write_error(frames: Pointer, last: int, tip: Single, target: Single, error: Pointer, left: Pointer) -> Lanes:
    """Write the twist from the tips to `target` (3, 4) and its two squared lengths; returns the positions of the tips.

    The length of its second half is twice the sine of half the remaining angle, in place of the angle.
    """
    f = FRAME * last
    px, py, pz = load(frames, f + 9 * LANES), load(frames, f + 10 * LANES), load(frames, f + 11 * LANES)
    x = y = z = trace = splat(0.0)
    for k in range(4):
        cx = cy = cz = splat(0.0)
        for i in range(3):
            at = f + 3 * i * LANES
            cx = cx + tip[i, k] * load(frames, at)
            cy = cy + tip[i, k] * load(frames, at + LANES)
            cz = cz + tip[i, k] * load(frames, at + 2 * LANES)
        if k == 3:
            px, py, pz = px + cx, py + cy, pz + cz
        else:
            x = x + (target[2, k] * cy - target[1, k] * cz)
            y = y + (target[0, k] * cz - target[2, k] * cx)
            z = z + (target[1, k] * cx - target[0, k] * cy)
            trace = trace + (target[0, k] * cx + target[1, k] * cy + target[2, k] * cz)
    half = 0.5 / root(larger(0.25 * trace + 0.25, splat(HALF_TURN)))
    ex, ey, ez = target[0, 3] - px, target[1, 3] - py, target[2, 3] - pz
    store(error, 0, ex)
    store(error, LANES, ey)
    store(error, 2 * LANES, ez)
    store(error, 3 * LANES, half * x)
    store(error, 4 * LANES, half * y)
    store(error, 5 * LANES, half * z)
    store(left, 0, ex * ex + ey * ey + ez * ez)
    store(left, LANES, larger(3.0 - trace, splat(0.0)))
    return px, py, pz


@inlined
def descend_once(
    robot: RobotArrays, tip: Single, target: Single, lower: Single, upper: Single, damping: float, memory: Descents
) -> None:
    """One step of all 16 descents, as `inverse.step`; their errors before it are left in `memory`.

    `tip` and `target` (3, 4); `lower` and `upper` (dof,).
    """
    dof = lower.shape[0]
    joints, frames, jac, a = (
        pointer(memory.joints),
        pointer(memory.frames),
        pointer(memory.jacobian),
        pointer(memory.normal),
    )
    e, left = pointer(memory.error), pointer(memory.left)
    place_joints(dof, pointer(robot.tree), pointer(robot.origin), joints, frames)
    px, py, pz = _write_error(frames, dof, tip, target, e, left)
    damped = damping * (load(left, 0) + load(left, LANES)) + LEAST
    row = dof * LANES
    for k in range(dof):
        f, at = FRAME * (k + 1), k * LANES
        zx, zy, zz = load(frames, f + 6 * LANES), load(frames, f + 7 * LANES), load(frames, f + 8 * LANES)
        if robot.tree[k, 1] != 0:
            rx, ry, rz = (
                px - load(frames, f + 9 * LANES),
                py - load(frames, f + 10 * LANES),
                pz - load(frames, f + 11 * LANES),
            )
            store(jac, at, zy * rz - zz * ry)
            store(jac, at + row, zz * rx - zx * rz)
            store(jac, at + 2 * row, zx * ry - zy * rx)
            store(jac, at + 3 * row, zx)
            store(jac, at + 4 * row, zy)
            store(jac, at + 5 * row, zz)
        else:
            store(jac, at, zx)
            store(jac, at + row, zy)
            store(jac, at + 2 * row, zz)
            for i in range(3, 6):
                store(jac, at + i * row, splat(0.0))
    for i in range(6):  # Cholesky: a = L L^T
        for j in range(i + 1):
            value = damped if i == j else splat(0.0)
            for k in range(dof):
                value = value + load(jac, i * row + k * LANES) * load(jac, j * row + k * LANES)
            for k in range(j):
                value = value - load(a, LANES * (i * (i + 1) // 2 + k)) * load(a, LANES * (j * (j + 1) // 2 + k))
            pivot = LANES * (j * (j + 1) // 2 + j)
            value = root(larger(value, splat(PIVOT))) if i == j else value / load(a, pivot)
            store(a, LANES * (i * (i + 1) // 2 + j), value)
    for i in range(6):
        value = load(e, i * LANES)
        for k in range(i):
            value = value - load(a, LANES * (i * (i + 1) // 2 + k)) * load(e, k * LANES)
        store(e, i * LANES, value / load(a, LANES * (i * (i + 1) // 2 + i)))
    for i in range(5, -1, -1):
        value = load(e, i * LANES)
        for k in range(i + 1, 6):
            value = value - load(a, LANES * (k * (k + 1) // 2 + i)) * load(e, k * LANES)
        store(e, i * LANES, value / load(a, LANES * (i * (i + 1) // 2 + i)))
    for k in range(dof):
        q = load(joints, k * LANES)
        for i in range(6):
            q = q + load(jac, i * row + k * LANES) * load(e, i * LANES)
        if robot.tree[k, 1] != 0 and upper[k] - lower[k] >= TURN:
            outside = larger(q - upper[k], lower[k] - q)
            q = q - where_positive(outside, TURN * nearest((q - lower[k]) * (1.0 / TURN) - 0.5))
        store(joints, k * LANES, smaller(larger(q, splat(lower[k])), splat(upper[k])))
