"""Inverse kinematics: Levenberg-Marquardt from many seeds; finds distinct solutions and checks them for collision."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.kernels.arrays import Memory, RobotArrays, Space, WorldArrays, space
from zarm_geometry.kernels.compiled import inlined, kernel
from zarm_geometry.kernels.edge import edge_free
from zarm_geometry.kernels.kinematics import joint_frames
from zarm_geometry.kernels.simd import LANES
from zarm_geometry.kernels.vectors import copy
from zarm_planner.kernels.clock import passed
from zarm_planner.kernels.descents import descend_once, make_descents
from zarm_planner.kernels.random import uniform
from zarm_trajectory.arrays import Array, Index, Single

TURN = 2.0 * math.pi
TOLERANCE = 1e-6
"""Largest error of a solution in position (m) and in orientation (rad)."""
SEEDS = 500
"""Maximum number of descents. Of 100,000 random poses of five arms, all but 2 found their first solution within this
number, and 99.9 % within 79.
"""
PATIENCE = 30
"""The search for further solutions ends after this many in a row that are not new and free."""
DISTINCT = 0.1
"""Solutions that differ by less than this (rad) in every joint count as the same."""
ITERATIONS = 50
"""Maximum number of steps of a descent; most end after 9."""
DAMPING = 0.05
"""Damping per squared error. From 0.005 to 0.15 the number of descents is the same."""
CLOSE = 1e-3
"""Remaining error, in m and rad together, below which a descent is finished in double precision."""
STALL = 0.7
"""A descent ends if more than this fraction of its error is left after 3 steps, since another seed then gets there
sooner.

With a limit of 0.9 after 5 steps, a solution took 42 steps on average on a Panda, now 29; on a UR with joints limited
to one turn 40, now 29; on other arms 9 to 11, as now.
"""


class Chain(NamedTuple):
    """The kinematics of a robot whose joints all move the tip.

    `tree` (dof, 2) and `origin` (dof, 3, 4) as in `joint_frames`; `tip` (4, 4): the tip in the last joint's frame;
    `lower` and `upper` (dof,): the joints' ranges in rad (m if prismatic).
    """

    tree: Index
    origin: Array
    tip: Array
    lower: Array
    upper: Array


class Work(NamedTuple):
    """Working memory: frames of the joints (dof, 3, 4), pose of the tip (3, 4), Jacobian (6, dof), normal equations (6,
    6), and the remaining twist (6,) in m and rad.
    """

    frames: Array
    pose: Array
    jacobian: Array
    normal: Array
    error: Array


class Found(NamedTuple):
    """The result of `solve`: the numbers of free and of colliding solutions, and the smallest error reached, in m and
    in rad.
    """

    free: int
    colliding: int
    distance: float
    angle: float


@inlined
def make_work(dof: int) -> Work:
    """Allocate the working memory for one call of a kernel."""
    return Work(np.empty((dof, 3, 4)), np.empty((3, 4)), np.empty((6, dof)), np.empty((6, 6)), np.empty(6))


@inlined
def tip_pose(chain: Chain, q: Array, work: Work) -> None:
    """Write the frames of the joints at `q` (dof,) and the pose of the tip into `work`."""
    joint_frames(chain.tree, chain.origin, q, work.frames)
    last = q.shape[0] - 1
    for i in range(3):
        for j in range(4):
            value = work.frames[last, i, 3] if j == 3 else 0.0
            for k in range(3):
                value += work.frames[last, i, k] * chain.tip[k, j]
            work.pose[i, j] = value


@inlined
def tip_jacobian(chain: Chain, work: Work) -> None:
    """Write the Jacobian (6, dof) of the tip in the base frame into `work`: m and rad per rad (m if prismatic). Call
    `tip_pose` first.
    """
    jac = work.jacobian
    for k in range(jac.shape[1]):
        f = work.frames[k]
        zx, zy, zz = f[0, 2], f[1, 2], f[2, 2]
        if chain.tree[k, 1] != 0:
            rx, ry, rz = work.pose[0, 3] - f[0, 3], work.pose[1, 3] - f[1, 3], work.pose[2, 3] - f[2, 3]
            jac[0, k], jac[1, k], jac[2, k] = zy * rz - zz * ry, zz * rx - zx * rz, zx * ry - zy * rx
            jac[3, k], jac[4, k], jac[5, k] = zx, zy, zz
        else:
            jac[0, k], jac[1, k], jac[2, k] = zx, zy, zz
            jac[3, k], jac[4, k], jac[5, k] = 0.0, 0.0, 0.0


@inlined
def pose_error(chain: Chain, target: Array, q: Array, work: Work) -> tuple[float, float]:
    """Write the twist (6,) from the tip at `q` to `target` (4, 4) into `work.error`; returns its lengths in m and in
    rad.
    """
    tip_pose(chain, q, work)
    # The remaining rotation, target * pose^-1, as an axis times an angle.
    t, p, e = target, work.pose, work.error
    x = y = z = trace = 0.0
    for k in range(3):
        x += t[2, k] * p[1, k] - t[1, k] * p[2, k]
        y += t[0, k] * p[2, k] - t[2, k] * p[0, k]
        z += t[1, k] * p[0, k] - t[0, k] * p[1, k]
        trace += t[0, k] * p[0, k] + t[1, k] * p[1, k] + t[2, k] * p[2, k]
    sine, cosine = 0.5 * math.sqrt(x * x + y * y + z * z), 0.5 * (trace - 1.0)
    angle = math.atan2(sine, cosine)
    factor = 0.5 * angle / sine if sine > 1e-9 else 0.5
    e[3], e[4], e[5] = factor * x, factor * y, factor * z
    if sine <= 1e-9 and cosine < 0.0:  # half a turn: any axis will do
        e[3] = angle
    for i in range(3):
        e[i] = t[i, 3] - p[i, 3]
    return math.sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2]), angle


@inlined
def step(chain: Chain, q: Array, damping: float, work: Work) -> None:
    """Move `q` by J^T (J J^T + damping I)^-1 error, and clamp it to its limits."""
    dof = q.shape[0]
    jac, a, e = work.jacobian, work.normal, work.error
    tip_jacobian(chain, work)
    for i in range(6):  # Cholesky: a = L L^T
        for j in range(i + 1):
            value = damping if i == j else 0.0
            for k in range(dof):
                value += jac[i, k] * jac[j, k]
            for k in range(j):
                value -= a[i, k] * a[j, k]
            a[i, j] = math.sqrt(max(value, 1e-300)) if i == j else value / a[j, j]
    for i in range(6):
        for k in range(i):
            e[i] -= a[i, k] * e[k]
        e[i] /= a[i, i]
    for i in range(5, -1, -1):
        for k in range(i + 1, 6):
            e[i] -= a[k, i] * e[k]
        e[i] /= a[i, i]
    for k in range(dof):
        for i in range(6):
            q[k] += jac[i, k] * e[i]
        outside = q[k] > chain.upper[k] or q[k] < chain.lower[k]
        if outside and chain.tree[k, 1] != 0 and chain.upper[k] - chain.lower[k] >= TURN:
            q[k] -= TURN * math.floor((q[k] - chain.lower[k]) / TURN)
        q[k] = min(max(q[k], chain.lower[k]), chain.upper[k])


@inlined
def descend(chain: Chain, target: Array, q: Array, work: Work) -> tuple[float, float]:
    """Levenberg-Marquardt from `q`, in place, damped by the error itself; returns the remaining error in m and in rad.

    Sugihara, "Solvability-unconcerned inverse kinematics by the Levenberg-Marquardt method", 2011.
    """
    distance, angle = pose_error(chain, target, q, work)
    before = 1e9
    for iteration in range(ITERATIONS):
        if distance < TOLERANCE and angle < TOLERANCE:
            break
        if iteration % 3 == 2:
            if distance + angle > STALL * before:
                break
            before = distance + angle
        step(chain, q, DAMPING * (distance * distance + angle * angle) + 1e-9, work)
        distance, angle = pose_error(chain, target, q, work)
    return distance, angle


@inlined
def bring_near(chain: Chain, near: Array, q: Array) -> None:
    """Turn revolute joints by full turns to be as close to `near` (dof,) as their limits allow."""
    for k in range(q.shape[0]):
        if chain.tree[k, 1] != 0:
            turns = round((near[k] - q[k]) / TURN)
            most = math.floor((chain.upper[k] - q[k]) / TURN)
            least = -math.floor((q[k] - chain.lower[k]) / TURN)
            q[k] += TURN * min(max(turns, least), most)


@inlined
def known(solutions: Array, count: int, q: Array) -> bool:
    """Whether `q` is the same as one of the first `count` solutions, see DISTINCT."""
    for s in range(count):
        farthest = 0.0
        for k in range(q.shape[0]):
            farthest = max(farthest, abs(solutions[s, k] - q[k]))
        if farthest < DISTINCT:
            return True
    return False


class Solutions(NamedTuple):
    """The solutions found so far: rows of `free` and of `colliding` (n, dof).

    `counts` (3,): how many there are of each, and how many descents in a row led to none that is new and free.
    `missed` (2,): the smallest error reached, in m and in rad.
    """

    free: Array
    colliding: Array
    counts: NDArray[np.int64]
    missed: Array


@inlined
def complete(solutions: Solutions) -> bool:
    """Whether there is no room for more solutions, or none has been new and free for long, see PATIENCE."""
    good, bad, again = solutions.counts
    return bool(good == solutions.free.shape[0] or bad == solutions.colliding.shape[0] or again >= PATIENCE)


@inlined
def note_error(solutions: Solutions, distance: float, angle: float) -> None:
    """Remember how close (m, rad) a descent came."""
    if distance + angle < solutions.missed[0] + solutions.missed[1]:
        solutions.missed[0], solutions.missed[1] = distance, angle


@inlined
def draw(chain: Chain, solutions: Solutions, random: NDArray[np.uint64], number: int, q: Array) -> None:
    """Write the `number`-th seed of a descent to `q` (dof,)."""
    dof, good = q.shape[0], solutions.counts[0]
    for k in range(dof):
        q[k] = chain.lower[k] + (chain.upper[k] - chain.lower[k]) * uniform(random)
    if dof > 6 and good > 0 and number % 2 == 0:
        # The solutions of a redundant arm form curves, and a known one with half of its joints changed is a good seed
        # for the next. Without redundancy it would lead back to the known solutions.
        one = math.floor(good * uniform(random))
        for k in range(dof):
            if uniform(random) < 0.5:
                q[k] = solutions.free[one, k]


@inlined
def finish(
    chain: Chain,
    checks: Space,
    checked: bool,
    target: Array,
    near: Array,
    solutions: Solutions,
    q: Array,
    single: Single,
    work: Work,
) -> None:
    """Descend from `q` (dof,) and add the solution, if there is one and it is new. `single` (dof,) is working memory."""
    distance, angle = descend(chain, target, q, work)
    note_error(solutions, distance, angle)
    if distance > TOLERANCE or angle > TOLERANCE:
        return
    bring_near(chain, near, q)
    solutions.counts[2] += 1
    good, bad, _ = solutions.counts
    if known(solutions.free, good, q) or known(solutions.colliding, bad, q):
        return
    copy(q, single)
    if checked and not edge_free(checks, single, single):
        copy(q, solutions.colliding[bad])
        solutions.counts[1] += 1
        if good > 0:  # a redundant arm has any number of colliding ones
            return
    else:
        copy(q, solutions.free[good])
        solutions.counts[0] += 1
    solutions.counts[2] = 0


@kernel
def solve(
    chain: Chain,
    robot: RobotArrays,
    world: WorldArrays,
    memory: Memory,
    checked: bool,
    target: Array,
    near: Array,
    free: Array,
    colliding: Array,
    random: NDArray[np.uint64],
    deadline: NDArray[np.float64],
) -> Found:
    """Solve for the pose `target` (4, 4), first from `near` (dof,), then from random seeds; each solution is turned as
    close to `near` as possible.

    Fills the rows of `free` and, if `checked`, of `colliding`; ends when either is full.
    """
    dof = near.shape[0]
    checks, work = space(robot, world, memory), make_work(dof)
    solutions = Solutions(free, colliding, np.zeros(3, np.int64), np.full(2, 1e9))
    now = np.empty(2, np.int64)
    q, single = np.empty(dof), np.empty(dof, np.float32)
    for k in range(dof):
        q[k] = min(max(near[k], chain.lower[k]), chain.upper[k])
    if not passed(deadline, now):
        finish(chain, checks, checked, target, near, solutions, q, single, work)
    if complete(solutions):
        return Found(solutions.counts[0], solutions.counts[1], solutions.missed[0], solutions.missed[1])
    # 16 descents run side by side; where one ends, the next seed takes its place.
    descents = make_descents(dof)
    tip, aim = chain.tip[:3].astype(np.float32), target[:3].astype(np.float32)
    lower, upper = chain.lower.astype(np.float32), chain.upper.astype(np.float32)
    steps, before = np.empty(LANES, np.int64), np.empty(LANES)
    seed = 0
    for lane in range(LANES):
        seed += 1
        draw(chain, solutions, random, seed, q)
        steps[lane], before[lane] = 0, 1e9
        for k in range(dof):
            descents.joints[k, lane] = q[k]
    while seed < SEEDS and not complete(solutions) and not passed(deadline, now):
        descend_once(robot, tip, aim, lower, upper, DAMPING, descents)
        for lane in range(LANES):
            # In place of the angle, twice the sine of half of it.
            distance, chord = math.sqrt(descents.left[0, lane]), math.sqrt(descents.left[1, lane])
            steps[lane] += 1
            near_by = distance + chord < CLOSE
            if not near_by:
                if steps[lane] % 3 != 0:
                    continue
                if distance + chord <= STALL * before[lane] and steps[lane] < ITERATIONS:
                    before[lane] = distance + chord
                    continue
                note_error(solutions, distance, 2.0 * math.asin(min(1.0, 0.5 * chord)))
            else:
                for k in range(dof):
                    q[k] = descents.joints[k, lane]
                finish(chain, checks, checked, target, near, solutions, q, single, work)
                if complete(solutions):
                    break
            seed += 1
            draw(chain, solutions, random, seed, q)
            steps[lane], before[lane] = 0, 1e9
            for k in range(dof):
                descents.joints[k, lane] = q[k]
    return Found(solutions.counts[0], solutions.counts[1], solutions.missed[0], solutions.missed[1])
