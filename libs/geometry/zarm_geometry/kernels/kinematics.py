"""Forward kinematics of single configurations in float64, for results and exact verification."""

from __future__ import annotations

import math

import numpy as np

from zarm_geometry.kernels.compiled import brief, inlined
from zarm_trajectory.arrays import Array, Index


@inlined
def joint_frames(tree: Index, origin: Array, q: Array, out: Array) -> None:
    """Write to `out` (dof, 3, 4) the frames that move with each joint, in the base frame.

    `tree` (dof, 2): the joint that carries each joint, an earlier one, or -1 for the base; and 0 if it is prismatic.
    `origin` (dof, 3, 4): each joint's frame in that of the joint that carries it at q = 0, with its axis along z.
    """
    for k in range(q.shape[0]):
        carrier, revolute = tree[k, 0], tree[k, 1] != 0
        c = math.cos(q[k]) if revolute else 1.0
        s = math.sin(q[k]) if revolute else 0.0
        slide = 0.0 if revolute else q[k]
        for i in range(3):
            if carrier < 0:
                x, y, z, p = origin[k, i, 0], origin[k, i, 1], origin[k, i, 2], origin[k, i, 3]
            else:
                a, b, d = out[carrier, i, 0], out[carrier, i, 1], out[carrier, i, 2]
                x = a * origin[k, 0, 0] + b * origin[k, 1, 0] + d * origin[k, 2, 0]
                y = a * origin[k, 0, 1] + b * origin[k, 1, 1] + d * origin[k, 2, 1]
                z = a * origin[k, 0, 2] + b * origin[k, 1, 2] + d * origin[k, 2, 2]
                p = a * origin[k, 0, 3] + b * origin[k, 1, 3] + d * origin[k, 2, 3] + out[carrier, i, 3]
            out[k, i, 0] = c * x + s * y
            out[k, i, 1] = c * y - s * x
            out[k, i, 2] = z
            out[k, i, 3] = p + slide * z


@brief
def frames(tree: Index, origin: Array, joint: Index, offset: Array, q: Array, out: Array) -> None:
    """Write to `out` (n, m, 4, 4) the transforms of m frames in the base frame, for the n configurations `q` (n, dof).

    Frame j is rigidly attached to the joint `joint[j]`, or to the base if that is -1, at `offset[j]` (4, 4).
    """
    moving = np.empty((q.shape[1], 3, 4))
    for n in range(q.shape[0]):
        joint_frames(tree, origin, q[n], moving)
        for j in range(joint.shape[0]):
            for i in range(3):
                for c in range(4):
                    if joint[j] < 0:
                        out[n, j, i, c] = offset[j, i, c]
                    else:
                        m = moving[joint[j], i]
                        value = m[0] * offset[j, 0, c] + m[1] * offset[j, 1, c] + m[2] * offset[j, 2, c]
                        out[n, j, i, c] = value + m[3] if c == 3 else value
            out[n, j, 3, 0] = out[n, j, 3, 1] = out[n, j, 3, 2] = 0.0
            out[n, j, 3, 3] = 1.0
