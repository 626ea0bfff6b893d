"""The torques that a motion needs."""

from __future__ import annotations

import numpy as np

from zarm_geometry.kernels.compiled import inlined, kernel
from zarm_geometry.kernels.convex import Turn, Vector, turned, turned_back
from zarm_geometry.kernels.kinematics import joint_frames
from zarm_trajectory.arrays import Array, Index

GRAVITY = 9.81
"""m/s², along -z of the base."""


@inlined
def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inlined
def _plus(a: Vector, b: Vector) -> Vector:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inlined
def _by(factor: float, a: Vector) -> Vector:
    return factor * a[0], factor * a[1], factor * a[2]


@inlined
def _at(rows: Array, j: int) -> Vector:
    return rows[j, 0], rows[j, 1], rows[j, 2]


@inlined
def _set(rows: Array, j: int, a: Vector) -> None:
    rows[j, 0], rows[j, 1], rows[j, 2] = a


@inlined
def _column(frame: Array, j: int, k: int) -> Vector:
    return frame[j, 0, k], frame[j, 1, k], frame[j, 2, k]


@inlined
def _turn_of(m: Array, j: int) -> Turn:
    return m[j, 0, 0], m[j, 0, 1], m[j, 0, 2], m[j, 1, 0], m[j, 1, 1], m[j, 1, 2], m[j, 2, 0], m[j, 2, 1], m[j, 2, 2]


@kernel
def torques(
    tree: Index, origin: Array, mass: Array, center: Array, inertia: Array, q: Array, v: Array, a: Array, out: Array
) -> None:
    """Write to `out` (n, dof) the torques (Nm; N if prismatic) of the motion `q`, `v`, `a` (n, dof).

    `tree` and `origin` as in `joint_frames`. What each joint carries up to the next ones has a `mass` (dof,), its `center`
    (dof, 3) and `inertia` (dof, 3, 3) about that in the joint's frame. The recursive Newton-Euler algorithm (Luh, Walker and
    Paul, 1980), in the base frame.
    """
    dof = q.shape[1]
    frame, moved = np.empty((dof, 3, 4)), np.empty((5, dof, 3))
    spin, turn, pull, force, moment = moved[0], moved[1], moved[2], moved[3], moved[4]
    for n in range(q.shape[0]):
        joint_frames(tree, origin, q[n], frame)
        for j in range(dof):
            carrier, revolute = tree[j, 0], tree[j, 1] != 0
            z, r = _column(frame, j, 2), _column(frame, j, 3)
            w, dw, g = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, GRAVITY)
            if carrier >= 0:
                w, dw, g = _at(spin, carrier), _at(turn, carrier), _at(pull, carrier)
                r = _plus(r, _by(-1.0, _column(frame, carrier, 3)))
            g = _plus(g, _plus(_cross(dw, r), _cross(w, _cross(w, r))))
            if revolute:
                dw = _plus(dw, _plus(_by(a[n, j], z), _by(v[n, j], _cross(w, z))))
                w = _plus(w, _by(v[n, j], z))
            else:
                g = _plus(g, _plus(_by(a[n, j], z), _by(2.0 * v[n, j], _cross(w, z))))
            _set(spin, j, w)
            _set(turn, j, dw)
            _set(pull, j, g)
            rotation, tensor = _turn_of(frame, j), _turn_of(inertia, j)
            arm = turned(rotation, _at(center, j))
            f = _by(mass[j], _plus(g, _plus(_cross(dw, arm), _cross(w, _cross(w, arm)))))
            own = turned_back(rotation, w)
            change = _plus(turned(tensor, turned_back(rotation, dw)), _cross(own, turned(tensor, own)))
            _set(force, j, f)
            _set(moment, j, _plus(turned(rotation, change), _cross(arm, f)))
        for j in range(dof - 1, -1, -1):
            z, f, m, carrier = _column(frame, j, 2), _at(force, j), _at(moment, j), tree[j, 0]
            borne = m if tree[j, 1] != 0 else f
            out[n, j] = z[0] * borne[0] + z[1] * borne[1] + z[2] * borne[2]
            if carrier >= 0:
                r = _plus(_column(frame, j, 3), _by(-1.0, _column(frame, carrier, 3)))
                _set(moment, carrier, _plus(_at(moment, carrier), _plus(m, _cross(r, f))))
                _set(force, carrier, _plus(_at(force, carrier), f))
