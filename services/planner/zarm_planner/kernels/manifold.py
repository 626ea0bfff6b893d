"""The manifold of configurations that keep some components of the tip's pose: deviation from it, projection onto it,
and steps along it.

Berenson, Srinivasa, Ferguson and Kuffner, "Manipulation planning on constraint manifolds", 2009.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.kernels.compiled import inlined, kernel
from zarm_geometry.kernels.kinematics import joint_frames
from zarm_geometry.kernels.vectors import apart, copy
from zarm_planner.kernels.inverse import Chain, Work, make_work, tip_jacobian
from zarm_trajectory.arrays import Array, Index, Single

CLOSE = 1e-5
"""Largest deviation (m, rad) of a projected configuration. The rest of the tolerance is left for the deviation between
configurations.
"""
STEP = 0.2
"""Longest step (rad, Euclidean) along the manifold."""
SHORTEST = STEP / 16
"""If not even a step of this length (rad) stays on the manifold, `advance` fails."""
SLACK = 0.5
"""Halfway along a step, which is straight, at most this fraction of the tolerance may be used."""
ITERATIONS = 20
"""Maximum number of iterations of a projection; from one step away it usually takes 2."""
DAMPING = 0.01
"""Damping per squared deviation, as in Levenberg-Marquardt."""


class ConstraintArrays(NamedTuple):
    """A path constraint: components of the tip's pose that must not change, numbered as [theta_x, theta_y, theta_z, x,
    y, z]. The pose is that in the base frame, or in a reference frame that moves too.

    `joints` (2,): the joint that carries the tip of `chain`, and the one that carries the reference, -1 for the base;
    `reference` (4, 4): the reference in its joint's frame; `sign` (dof,): how the tip moves as seen from the reference
    when a joint does: 1 for a joint that moves the tip alone, -1 for one that moves the reference alone, otherwise 0.
    `start` (4, 4): the pose whose components are kept; `frame` (3, 3): rotates from the reference to the frame of the
    components; `axes` (m,): the numbers of the constrained components; `tolerance` (6,) in rad and m.
    """

    chain: Chain
    joints: Index
    reference: Array
    sign: Array
    start: Array
    frame: Array
    axes: NDArray[np.int64]
    tolerance: Array


class Workspace(NamedTuple):
    """Working memory: that of the kinematics; the pose of the reference, and that of the tip in it (3, 4); the rotation
    vector (3,); the deviation (6,); the constrained rows of the Jacobian (6, dof), their normal equations (6, 6) and
    right side (6,); which joints are at a limit (dof,); two configurations (dof,).
    """

    work: Work
    reference: Array
    pose: Array
    turn: Array
    deviation: Array
    rows: Array
    normal: Array
    right: Array
    stuck: NDArray[np.bool_]
    q: Array
    middle: Array


@inlined
def make_workspace(dof: int) -> Workspace:
    """Allocate the working memory for one call of a kernel."""
    return Workspace(
        make_work(dof),
        np.eye(3, 4),
        np.empty((3, 4)),
        np.empty(3),
        np.empty(6),
        np.empty((6, dof)),
        np.empty((6, 6)),
        np.empty(6),
        np.empty(dof, np.bool_),
        np.empty(dof),
        np.empty(dof),
    )


@inlined
def rotation_vector(a: Array, b: Array, out: Array) -> None:
    """Write axis times angle (0..pi) of the rotation a b^T; `a` and `b` are poses or rotations.

    It goes through the quaternion, whose largest component is taken from the diagonal (Shepperd, "Quaternion from
    rotation matrix", 1978), and so is accurate at any angle, including half a turn.
    """
    r00 = a[0, 0] * b[0, 0] + a[0, 1] * b[0, 1] + a[0, 2] * b[0, 2]
    r11 = a[1, 0] * b[1, 0] + a[1, 1] * b[1, 1] + a[1, 2] * b[1, 2]
    r22 = a[2, 0] * b[2, 0] + a[2, 1] * b[2, 1] + a[2, 2] * b[2, 2]
    r01 = a[0, 0] * b[1, 0] + a[0, 1] * b[1, 1] + a[0, 2] * b[1, 2]
    r10 = a[1, 0] * b[0, 0] + a[1, 1] * b[0, 1] + a[1, 2] * b[0, 2]
    r02 = a[0, 0] * b[2, 0] + a[0, 1] * b[2, 1] + a[0, 2] * b[2, 2]
    r20 = a[2, 0] * b[0, 0] + a[2, 1] * b[0, 1] + a[2, 2] * b[0, 2]
    r12 = a[1, 0] * b[2, 0] + a[1, 1] * b[2, 1] + a[1, 2] * b[2, 2]
    r21 = a[2, 0] * b[1, 0] + a[2, 1] * b[1, 1] + a[2, 2] * b[1, 2]
    trace = r00 + r11 + r22
    if trace >= max(r00, r11, r22):
        w, x, y, z = 1.0 + trace, r21 - r12, r02 - r20, r10 - r01
    elif r00 >= max(r11, r22):
        w, x, y, z = r21 - r12, 1.0 + 2.0 * r00 - trace, r10 + r01, r20 + r02
    elif r11 >= r22:
        w, x, y, z = r02 - r20, r10 + r01, 1.0 + 2.0 * r11 - trace, r21 + r12
    else:
        w, x, y, z = r10 - r01, r20 + r02, r21 + r12, 1.0 + 2.0 * r22 - trace
    if w < 0.0:
        w, x, y, z = -w, -x, -y, -z
    sine = math.sqrt(x * x + y * y + z * z)
    factor = 2.0 * math.atan2(sine, w) / sine if sine > 1e-12 * w else 2.0 / w
    out[0], out[1], out[2] = factor * x, factor * y, factor * z


@inlined
def frame_pose(frames: Array, joint: int, offset: Array, out: Array) -> None:
    """Write the pose (3, 4) of the frame `offset` (4, 4) on a joint, -1 for the base, from the frames of the joints."""
    for i in range(3):
        for j in range(4):
            if joint < 0:
                value = offset[i, j]
            else:
                value = frames[joint, i, 3] if j == 3 else 0.0
                for k in range(3):
                    value += frames[joint, i, k] * offset[k, j]
            out[i, j] = value


@inlined
def kept_pose(constraint: ConstraintArrays, q: Array, workspace: Workspace) -> None:
    """Write the pose (3, 4) of the tip in the reference at `q` (dof,) to `workspace.pose`."""
    chain, work, reference, pose = constraint.chain, workspace.work, workspace.reference, workspace.pose
    joint_frames(chain.tree, chain.origin, q, work.frames)
    frame_pose(work.frames, constraint.joints[0], chain.tip, work.pose)
    if constraint.joints[1] < 0:
        copy(work.pose[0], pose[0])
        copy(work.pose[1], pose[1])
        copy(work.pose[2], pose[2])
        return
    frame_pose(work.frames, constraint.joints[1], constraint.reference, reference)
    for j in range(4):
        x, y, z = work.pose[0, j], work.pose[1, j], work.pose[2, j]
        if j == 3:
            x, y, z = x - reference[0, 3], y - reference[1, 3], z - reference[2, 3]
        for i in range(3):
            pose[i, j] = reference[0, i] * x + reference[1, i] * y + reference[2, i] * z


@inlined
def deviate(constraint: ConstraintArrays, pose: Array, workspace: Workspace) -> float:
    """Write the deviation of `pose` (4, 4) from the start, all six components in rad and m, to `workspace.deviation`;
    returns the largest constrained one.

    Leaves the rotation vector in the reference's axes in `workspace.turn`.
    """
    rotation_vector(pose, constraint.start, workspace.turn)
    d, f, s = workspace.deviation, constraint.frame, constraint.start
    for i in range(3):
        d[i] = f[i, 0] * workspace.turn[0] + f[i, 1] * workspace.turn[1] + f[i, 2] * workspace.turn[2]
        d[3 + i] = (
            f[i, 0] * (pose[0, 3] - s[0, 3]) + f[i, 1] * (pose[1, 3] - s[1, 3]) + f[i, 2] * (pose[2, 3] - s[2, 3])
        )
    worst = 0.0
    for i in range(constraint.axes.shape[0]):
        worst = max(worst, abs(d[constraint.axes[i]]))
    return worst


@inlined
def used(constraint: ConstraintArrays, workspace: Workspace) -> float:
    """The largest fraction of a tolerance that `workspace.deviation` uses."""
    worst = 0.0
    for i in range(constraint.axes.shape[0]):
        worst = max(worst, abs(workspace.deviation[constraint.axes[i]]) / constraint.tolerance[constraint.axes[i]])
    return worst


@inlined
def constrained_rows(constraint: ConstraintArrays, workspace: Workspace) -> None:
    """Write the derivatives of the constrained components by each joint to `workspace.rows`; 0 for joints at a limit.

    The rotation vector phi changes with the angular velocity w as J(phi) w, where J is the inverse left Jacobian of
    SO(3), 1 - [phi] / 2 + c [phi]^2 (Sola, Deray and Atchuthan, "A micro Lie theory for state estimation in robotics",
    2018).
    """
    tip_jacobian(constraint.chain, workspace.work)
    jac, phi, r = workspace.work.jacobian, workspace.turn, workspace.reference
    square = phi[0] * phi[0] + phi[1] * phi[1] + phi[2] * phi[2]
    half = 0.5 * math.sqrt(square)
    c = (1.0 - half / math.tan(half)) / square if square > 1e-6 else 1.0 / 12.0
    for k in range(jac.shape[1]):
        sign = constraint.sign[k]
        vx, vy, vz = sign * jac[0, k], sign * jac[1, k], sign * jac[2, k]
        wx, wy, wz = sign * jac[3, k], sign * jac[4, k], sign * jac[5, k]
        if constraint.joints[1] >= 0:
            # In the reference's axes. The tip's point of the reference moves with it, so the lever arm is the same.
            vx, vy, vz = (
                r[0, 0] * vx + r[1, 0] * vy + r[2, 0] * vz,
                r[0, 1] * vx + r[1, 1] * vy + r[2, 1] * vz,
                r[0, 2] * vx + r[1, 2] * vy + r[2, 2] * vz,
            )
            wx, wy, wz = (
                r[0, 0] * wx + r[1, 0] * wy + r[2, 0] * wz,
                r[0, 1] * wx + r[1, 1] * wy + r[2, 1] * wz,
                r[0, 2] * wx + r[1, 2] * wy + r[2, 2] * wz,
            )
        ax, ay, az = phi[1] * wz - phi[2] * wy, phi[2] * wx - phi[0] * wz, phi[0] * wy - phi[1] * wx
        wx += c * (phi[1] * az - phi[2] * ay) - 0.5 * ax
        wy += c * (phi[2] * ax - phi[0] * az) - 0.5 * ay
        wz += c * (phi[0] * ay - phi[1] * ax) - 0.5 * az
        for i in range(constraint.axes.shape[0]):
            if workspace.stuck[k]:
                workspace.rows[i, k] = 0.0
            elif constraint.axes[i] < 3:
                f = constraint.frame[constraint.axes[i]]
                workspace.rows[i, k] = f[0] * wx + f[1] * wy + f[2] * wz
            else:
                f = constraint.frame[constraint.axes[i] - 3]
                workspace.rows[i, k] = f[0] * vx + f[1] * vy + f[2] * vz


@inlined
def solve_normal(count: int, damping: float, workspace: Workspace) -> None:
    """Solve (rows rows^T + damping I) x = right in place for the first `count` rows, by Cholesky decomposition."""
    rows, a, x = workspace.rows, workspace.normal, workspace.right
    for i in range(count):
        for j in range(i + 1):
            value = damping if i == j else 0.0
            for k in range(rows.shape[1]):
                value += rows[i, k] * rows[j, k]
            for k in range(j):
                value -= a[i, k] * a[j, k]
            a[i, j] = math.sqrt(max(value, 1e-300)) if i == j else value / a[j, j]
    for i in range(count):
        for k in range(i):
            x[i] -= a[i, k] * x[k]
        x[i] /= a[i, i]
    for i in range(count - 1, -1, -1):
        for k in range(i + 1, count):
            x[i] -= a[k, i] * x[k]
        x[i] /= a[i, i]


@kernel
def project(constraint: ConstraintArrays, q: Array, workspace: Workspace) -> bool:
    """Project `q` (dof,) onto the manifold, in place, by damped least squares; returns False on failure.

    A joint that would leave its range stops at its limit, and the other joints do the rest.
    """
    dof, count = q.shape[0], constraint.axes.shape[0]
    lower, upper = constraint.chain.lower, constraint.chain.upper
    for k in range(dof):
        workspace.stuck[k] = False
        q[k] = min(max(q[k], lower[k]), upper[k])
    for _ in range(ITERATIONS):
        kept_pose(constraint, q, workspace)
        worst = deviate(constraint, workspace.pose, workspace)
        if worst <= CLOSE:
            return True
        constrained_rows(constraint, workspace)
        for i in range(count):
            workspace.right[i] = -workspace.deviation[constraint.axes[i]]
        solve_normal(count, DAMPING * worst * worst + 1e-12, workspace)
        for k in range(dof):
            for i in range(count):
                q[k] += workspace.rows[i, k] * workspace.right[i]
            if q[k] < lower[k] or q[k] > upper[k]:
                workspace.stuck[k] = True
                q[k] = min(max(q[k], lower[k]), upper[k])
    return False


@inlined
def step_kept(constraint: ConstraintArrays, a: Single, b: Single, workspace: Workspace) -> bool:
    """Whether a straight step from `a` to `b`, both on the manifold, uses at most SLACK of the tolerance halfway."""
    for k in range(a.shape[0]):
        workspace.middle[k] = 0.5 * (np.float64(a[k]) + np.float64(b[k]))
    kept_pose(constraint, workspace.middle, workspace)
    deviate(constraint, workspace.pose, workspace)
    return used(constraint, workspace) <= SLACK


@kernel
def advance(constraint: ConstraintArrays, here: Single, target: Single, there: Single, workspace: Workspace) -> bool:
    """Write to `there` a configuration on the manifold that is one step from `here` towards `target`, or `target`
    itself.

    Returns False if there is none. `here` and `target` are on the manifold.
    """
    left, step = apart(here, target), STEP
    while step >= SHORTEST:
        if left <= step:
            if step_kept(constraint, here, target, workspace):
                copy(target, there)
                return True
        else:
            for k in range(here.shape[0]):
                workspace.q[k] = here[k] + (target[k] - here[k]) * (step / left)
            if project(constraint, workspace.q, workspace):
                copy(workspace.q, there)
                if (
                    apart(here, there) <= 2.0 * step
                    and apart(there, target) <= left - 0.1 * step
                    and step_kept(constraint, here, there, workspace)
                ):
                    return True
        step *= 0.5
    return False


@kernel
def deviations(constraint: ConstraintArrays, poses: Array, out: Array) -> None:
    """Write to `out` the deviations (n, 6) of poses (n, 4, 4) from the start, in rad and m."""
    workspace = make_workspace(constraint.chain.lower.shape[0])
    for n in range(poses.shape[0]):
        deviate(constraint, poses[n], workspace)
        copy(workspace.deviation, out[n])


@kernel
def project_all(constraint: ConstraintArrays, rows: Array) -> int:
    """Project configurations (n, dof) onto the manifold, in place and in order, until one fails; returns how many
    succeeded.
    """
    workspace = make_workspace(rows.shape[1])
    done = 0
    while done < rows.shape[0] and project(constraint, rows[done], workspace):
        done += 1
    return done
