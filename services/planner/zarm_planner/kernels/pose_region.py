"""Configurations that bring frames of the robot into regions of poses: descents into the regions, and from there the
way inside them to the configuration that is reached soonest.

Each step is the weighted least-squares solution of the linearised problem. Bounds, of the regions and of the joints,
become equations once a step would cross them (an active-set method: Escande, Mansard and Wieber, "Hierarchical
quadratic programming", 2014).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.kernels.arrays import Memory, RobotArrays, Space, WorldArrays, space
from zarm_geometry.kernels.compiled import inlined, kernel
from zarm_geometry.kernels.edge import edge_free
from zarm_geometry.kernels.kinematics import joint_frames
from zarm_geometry.kernels.vectors import copy
from zarm_planner.kernels.clock import passed
from zarm_planner.kernels.inverse import DAMPING, STALL, TOLERANCE, Chain, bring_near, known
from zarm_planner.kernels.manifold import frame_pose, rotation_vector
from zarm_planner.kernels.random import uniform
from zarm_trajectory.arrays import Array, Single

PATIENCE = 10
"""The search for further solutions ends after this many descents in a row that lead to none that is new and free."""
ITERATIONS = 50
"""Maximum number of steps of a descent."""
LONGEST = 1.0
"""Longest step (rad) of a joint."""
ROUNDS = 25
"""Most rounds in which a step meets further bounds."""
BALL = 0.98
"""A step that would leave a ball leads to this fraction of its radius."""
SLIDES = 20
"""Maximum number of steps inside the regions."""
CUTS = 4
"""How often a step inside the regions is halved before the configuration counts as the best."""
CORRECTIONS = 5
"""Maximum number of steps back into the regions after one inside them."""
WORTH = 0.002
"""A step inside the regions that saves less than this fraction of the time is the last."""
POWER = 6
"""Exponent of the mean of the joints' times that stands for the largest of them."""


COMPONENTS = 7
"""Components of a pose's deviation: three of the rotation vector, three of the position, and its length."""


class Regions(NamedTuple):
    """m regions of poses, all to be met, and the robot's kinematics.

    `frame` (m, 4, 4): the frame that is brought into each region, as seen from the joint `joint` (m,), -1 for the base;
    `pose` (m, 4, 4): the region's middle. `turn` and `shift` (m, 3, 3) rotate from the base frame to the axes of the
    components of orientation and position. `tolerance` (m, 7): how far each component [theta_x, theta_y, theta_z, x, y,
    z, distance] may be off, in rad and m, infinite if it is free.
    """

    chain: Chain
    frame: Array
    joint: NDArray[np.int64]
    pose: Array
    turn: Array
    shift: Array
    tolerance: Array


class RegionWork(NamedTuple):
    """Working memory for m regions, n = 7 m components.

    Joint frames (dof, 3, 4), a pose (3, 4), a rotation vector and a shift (3,), deviations (n,), their derivatives (n,
    dof), which count as equations (n,), what each is to change by (n,), its damping (n,), normal equations (n, n), right side (n,); the
    step wanted and taken (dof,), inverse weights (dof,) and those in use (dof,), two configurations (dof,).
    """

    frames: Array
    pose: Array
    vector: Array
    moved: Array
    deviation: Array
    rows: Array
    active: NDArray[np.bool_]
    change: Array
    softness: Array
    normal: Array
    right: Array
    wanted: Array
    step: Array
    inverse: Array
    loose: Array
    q: Array
    entered: Array


@inlined
def make_region_work(regions: Regions, dof: int) -> RegionWork:
    """Allocate the working memory for one call of a kernel."""
    n = COMPONENTS * regions.joint.shape[0]
    return RegionWork(
        np.empty((dof, 3, 4)),
        np.empty((3, 4)),
        np.empty(3),
        np.empty(3),
        np.zeros(n),
        np.zeros((n, dof)),
        np.zeros(n, np.bool_),
        np.zeros(n),
        np.zeros(n),
        np.empty((n, n)),
        np.empty(n),
        np.empty(dof),
        np.empty(dof),
        np.empty(dof),
        np.empty(dof),
        np.empty(dof),
        np.empty(dof),
    )


@inlined
def place(regions: Regions, region: int, work: RegionWork) -> None:
    """Write the pose (3, 4) of a region's frame to `work.pose`, from the frames of the joints."""
    frame_pose(work.frames, regions.joint[region], regions.frame[region], work.pose)


@inlined
def measure(regions: Regions, q: Array, work: RegionWork) -> float:
    """Write the deviations at `q` (dof,) to `work.deviation`; returns by how much (m, rad) the worst exceeds its
    tolerance.
    """
    chain = regions.chain
    joint_frames(chain.tree, chain.origin, q, work.frames)
    worst = 0.0
    for region in range(regions.joint.shape[0]):
        place(regions, region, work)
        rotation_vector(work.pose, regions.pose[region], work.vector)
        for i in range(3):
            work.moved[i] = work.pose[i, 3] - regions.pose[region, i, 3]
        turn, shift, first = regions.turn[region], regions.shift[region], COMPONENTS * region
        for i in range(3):
            angle = distance = 0.0
            for k in range(3):
                angle += turn[i, k] * work.vector[k]
                distance += shift[i, k] * work.moved[k]
            work.deviation[first + i], work.deviation[first + 3 + i] = angle, distance
        work.deviation[first + 6] = math.sqrt(work.moved[0] ** 2 + work.moved[1] ** 2 + work.moved[2] ** 2)
        for i in range(COMPONENTS):
            worst = max(worst, abs(work.deviation[first + i]) - regions.tolerance[region, i])
    return worst


@inlined
def differentiate(regions: Regions, work: RegionWork) -> None:
    """Write the derivatives of the deviations by the joints to `work.rows`, except of the distance; call `measure` first.

    The rotation vector changes with the angular velocity by the inverse left Jacobian of SO(3), see
    `manifold.constrained_rows`.
    """
    chain, dof = regions.chain, work.step.shape[0]
    for region in range(regions.joint.shape[0]):
        place(regions, region, work)
        phi = work.vector
        rotation_vector(work.pose, regions.pose[region], phi)
        square = phi[0] * phi[0] + phi[1] * phi[1] + phi[2] * phi[2]
        half = 0.5 * math.sqrt(square)
        c = (1.0 - half / math.tan(half)) / square if square > 1e-6 else 1.0 / 12.0
        turn, shift, first = regions.turn[region], regions.shift[region], COMPONENTS * region
        for k in range(dof):
            wx = wy = wz = vx = vy = vz = 0.0
            if k <= regions.joint[region]:
                f = work.frames[k]
                zx, zy, zz = f[0, 2], f[1, 2], f[2, 2]
                if chain.tree[k, 1] != 0:
                    rx, ry, rz = work.pose[0, 3] - f[0, 3], work.pose[1, 3] - f[1, 3], work.pose[2, 3] - f[2, 3]
                    vx, vy, vz = zy * rz - zz * ry, zz * rx - zx * rz, zx * ry - zy * rx
                    ax, ay, az = phi[1] * zz - phi[2] * zy, phi[2] * zx - phi[0] * zz, phi[0] * zy - phi[1] * zx
                    wx = zx + c * (phi[1] * az - phi[2] * ay) - 0.5 * ax
                    wy = zy + c * (phi[2] * ax - phi[0] * az) - 0.5 * ay
                    wz = zz + c * (phi[0] * ay - phi[1] * ax) - 0.5 * az
                else:
                    vx, vy, vz = zx, zy, zz
            for i in range(3):
                work.rows[first + i, k] = turn[i, 0] * wx + turn[i, 1] * wy + turn[i, 2] * wz
                work.rows[first + 3 + i, k] = shift[i, 0] * vx + shift[i, 1] * vy + shift[i, 2] * vz


@inlined
def bounded(value: float, bound: float) -> float:
    """`value`, at most `bound` from 0."""
    return min(max(value, -bound), bound)


@inlined
def solve_active(work: RegionWork) -> None:
    """Write to `work.step` the step nearest to `work.wanted` in the metric 1 / `work.loose` that changes each active
    component by `work.change`, as far as its `work.softness` demands that; by Cholesky decomposition of the damped normal equations.
    """
    n, dof = work.active.shape[0], work.step.shape[0]
    a, x, rows, loose = work.normal, work.right, work.rows, work.loose
    for i in range(n):
        if not work.active[i]:
            continue
        x[i] = work.change[i]
        for k in range(dof):
            x[i] -= rows[i, k] * work.wanted[k]
        for j in range(i + 1):
            if not work.active[j]:
                continue
            value = work.softness[i] if i == j else 0.0
            for k in range(dof):
                value += rows[i, k] * loose[k] * rows[j, k]
            for k in range(j):
                if work.active[k]:
                    value -= a[i, k] * a[j, k]
            a[i, j] = math.sqrt(max(value, 1e-300)) if i == j else value / a[j, j]
        for k in range(i):
            if work.active[k]:
                x[i] -= a[i, k] * x[k]
        x[i] /= a[i, i]
    for i in range(n - 1, -1, -1):
        if not work.active[i]:
            continue
        for k in range(i + 1, n):
            if work.active[k]:
                x[i] -= a[k, i] * x[k]
        x[i] /= a[i, i]
    for k in range(dof):
        work.step[k] = work.wanted[k]
        for i in range(n):
            if work.active[i]:
                work.step[k] += loose[k] * rows[i, k] * x[i]


@inlined
def bound_distance(i: int, allowed: float, work: RegionWork) -> bool:
    """Make the step less free to leave the ball of radius `allowed` (m) if it does; `i` is the component of the
    distance. Returns whether it did.

    The multiplier of the ball's constraint is the inverse of the damping of x, y and z. Where that is small, the
    distance is in proportion to it, else less, so that this converges from outside.
    """
    dof, square, gain = work.step.shape[0], 0.0, 0.0
    for j in range(i - 3, i):
        there = work.deviation[j]
        for k in range(dof):
            gain += work.rows[j, k] * work.loose[k] * work.rows[j, k]
        for k in range(dof):
            there += work.rows[j, k] * work.step[k]
        square += there * there
    length = math.sqrt(square)
    if length <= allowed:
        return False
    for j in range(i - 3, i):
        share = BALL * allowed / length
        softer = work.softness[j] * share * share if work.active[j] else gain / 3.0 * share
        work.softness[j] = max(softer, 1e-12)
        work.active[j], work.change[j] = True, -work.deviation[j]
    return True


@inlined
def choose_step(regions: Regions, q: Array, damping: float, work: RegionWork) -> None:
    """Write to `work.step` the step from `q` (dof,) nearest to `work.wanted` in the metric 1 / `work.inverse` that
    leads into the regions, to first order, and stays within the joints' ranges; call `differentiate` first.
    """
    n, dof = work.active.shape[0], q.shape[0]
    lower, upper = regions.chain.lower, regions.chain.upper
    for i in range(n):
        region, component = i // COMPONENTS, i % COMPONENTS
        allowed = regions.tolerance[region, component]
        work.active[i] = component < 6 and (allowed <= 0.0 or abs(work.deviation[i]) > allowed)
        work.softness[i] = damping
        if work.active[i]:
            work.change[i] = bounded(work.deviation[i], allowed) - work.deviation[i]
    copy(work.inverse, work.loose)
    for _ in range(ROUNDS):
        solve_active(work)
        again = False
        for k in range(dof):
            there = q[k] + work.step[k]
            if work.loose[k] > 0.0 and (there < lower[k] - 1e-12 or there > upper[k] + 1e-12):
                work.wanted[k], work.loose[k] = min(max(there, lower[k]), upper[k]) - q[k], 0.0
                again = True
        if again:
            continue
        for i in range(n):
            allowed = regions.tolerance[i // COMPONENTS, i % COMPONENTS]
            if allowed == math.inf:
                continue
            if i % COMPONENTS == 6:
                again = bound_distance(i, allowed, work) or again
            elif not work.active[i]:
                there = work.deviation[i]
                for k in range(dof):
                    there += work.rows[i, k] * work.step[k]
                if abs(there) > allowed + 1e-12:
                    work.active[i], work.change[i] = True, bounded(there, allowed) - work.deviation[i]
                    again = True
        if not again:
            break
    longest = 0.0
    for k in range(dof):
        longest = max(longest, abs(work.step[k]))
    if longest > LONGEST:
        for k in range(dof):
            work.step[k] *= LONGEST / longest


@inlined
def move(regions: Regions, q: Array, work: RegionWork) -> None:
    """Add `work.step` to `q` (dof,), within the joints' ranges."""
    for k in range(q.shape[0]):
        q[k] = min(max(q[k] + work.step[k], regions.chain.lower[k]), regions.chain.upper[k])


@inlined
def enter(regions: Regions, q: Array, iterations: int, work: RegionWork) -> float:
    """Descend from `q` (dof,) into the regions, in place; returns by how much (m, rad) the worst component still
    exceeds its tolerance. Ends early where the descent stalls.
    """
    worst, before = measure(regions, q, work), 1e9
    for iteration in range(iterations):
        if worst < TOLERANCE:
            break
        if iteration % 3 == 2:
            if worst > STALL * before:
                break
            before = worst
        differentiate(regions, work)
        for k in range(q.shape[0]):
            work.wanted[k] = 0.0
        choose_step(regions, q, DAMPING * worst * worst + 1e-9, work)
        move(regions, q, work)
        worst = measure(regions, q, work)
    return worst


@inlined
def time_apart(a: Array, b: Array, speed: Array) -> float:
    """A smooth stand-in for the time (s) of the joint that needs longest from `a` to `b` (dof,) at its `speed`."""
    total = 0.0
    for k in range(a.shape[0]):
        total += (abs(b[k] - a[k]) / speed[k]) ** POWER
    return float(total ** (1.0 / POWER))


@inlined
def weigh(near: Array, speed: Array, q: Array, work: RegionWork) -> None:
    """Set the inverse weights of the joints so that a least-squares step reduces `time_apart` from `near`."""
    most = time_apart(q, near, speed) + 1e-12
    for k in range(q.shape[0]):
        share = max(abs(near[k] - q[k]) / speed[k] / most, 0.2)
        work.inverse[k] = speed[k] * speed[k] / share ** (POWER - 2)
    largest = 0.0
    for k in range(q.shape[0]):
        largest = max(largest, work.inverse[k])
    for k in range(q.shape[0]):
        work.inverse[k] /= largest


@inlined
def configuration_free(checks: Space, checked: bool, q: Array, single: Single) -> bool:
    """Whether `q` (dof,) is free of collision, in spheres; everything is unless it is `checked`."""
    if not checked:
        return True
    copy(q, single)
    return edge_free(checks, single, single)


@inlined
def approach(
    regions: Regions,
    checks: Space,
    checked: bool,
    near: Array,
    speed: Array,
    q: Array,
    free: bool,
    single: Single,
    work: RegionWork,
) -> bool:
    """Move `q` (dof,) inside the regions, in place, to where `near` is closest in time; returns whether it is free.

    From a free configuration it passes only free ones.
    """
    dof, time = q.shape[0], time_apart(q, near, speed)
    for _ in range(SLIDES):
        share, saved = 1.0, 0.0
        for _ in range(CUTS):
            measure(regions, q, work)
            differentiate(regions, work)
            weigh(near, speed, q, work)
            for k in range(dof):
                work.wanted[k] = share * (near[k] - q[k])
            choose_step(regions, q, 1e-9, work)
            copy(q, work.q)
            move(regions, work.q, work)
            if enter(regions, work.q, CORRECTIONS, work) < TOLERANCE:
                there = time_apart(work.q, near, speed)
                if there < time:
                    now_free = configuration_free(checks, checked, work.q, single)
                    if now_free or not free:
                        saved, time, free = time - there, there, now_free
                        copy(work.q, q)
                        break
            share *= 0.5
        if saved <= WORTH * time:
            break
    return free


class RegionsFound(NamedTuple):
    """The result of `solve_regions`: the numbers of free and of colliding solutions, and by how much (m, rad) the worst
    component of the best attempt exceeds its tolerance.
    """

    free: int
    colliding: int
    excess: float


@kernel
def solve_regions(
    regions: Regions,
    robot: RobotArrays,
    world: WorldArrays,
    memory: Memory,
    checked: bool,
    near: Array,
    speed: Array,
    free: Array,
    colliding: Array,
    missed: Array,
    random: NDArray[np.uint64],
    seeds: int,
    deadline: NDArray[np.float64],
) -> RegionsFound:
    """Solve for configurations inside the regions, first from `near` (dof,), then from random seeds; each is moved to
    where `near` is reached soonest with joints at their `speed` (dof,).

    Fills the rows of `free` and, if `checked`, of `colliding`; ends when either is full, or after `seeds` descents. Writes the deviations of the
    best attempt to `missed` (7 m,) while there is no solution.
    """
    chain, dof = regions.chain, near.shape[0]
    checks, work = space(robot, world, memory), make_region_work(regions, dof)
    now, single, q = np.empty(2, np.int64), np.empty(dof, np.float32), np.empty(dof)
    good = bad = again = 0
    least = 1e9
    for seed in range(seeds):
        if good == free.shape[0] or bad == colliding.shape[0] or again >= PATIENCE or passed(deadline, now):
            break
        for k in range(dof):
            q[k] = chain.lower[k] + (chain.upper[k] - chain.lower[k]) * uniform(random)
            if seed == 0:
                q[k] = min(max(near[k], chain.lower[k]), chain.upper[k])
            work.inverse[k] = 1.0
        excess = enter(regions, q, ITERATIONS, work)
        if excess < least:
            least = excess
            copy(work.deviation, missed)
        if excess > TOLERANCE:
            continue
        bring_near(chain, near, q)
        copy(q, work.entered)
        is_free = configuration_free(checks, checked, q, single)
        is_free = approach(regions, checks, checked, near, speed, q, is_free, single, work)
        again += 1
        if not known(free, good, q) and not known(colliding, bad, q):
            if is_free:
                copy(q, free[good])
                good += 1
                again = 0
            else:
                copy(q, colliding[bad])
                bad += 1
                again = again if good > 0 else 0
        # Spheres are larger than the links: where this one is not free either, it may be so in exact geometry.
        if not is_free and good == 0 and bad < colliding.shape[0] and not known(colliding, bad, work.entered):
            copy(work.entered, colliding[bad])
            bad += 1
            again = 0
    return RegionsFound(good, bad, least)


@kernel
def deviations_at(regions: Regions, q: Array, out: Array) -> None:
    """Write to `out` (7 m,) the deviations, in rad and m, of the regions' frames at `q` (dof,)."""
    work = make_region_work(regions, q.shape[0])
    measure(regions, q, work)
    copy(work.deviation, out)
