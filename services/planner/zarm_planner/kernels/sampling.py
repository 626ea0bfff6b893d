"""Sampling of a motion that is averaged over time: the sample times and the values.

The moving average of a motion with piecewise constant acceleration has piecewise constant jerk. Times at which the jerk
of a joint changes are called knots. Between two knots the joint follows one cubic, which the quintic through samples at
both describes exactly. Across a knot the quintic overshoots: its jerk exceeds that of the motion by up to 0.374 of the
change.
"""

from __future__ import annotations

import numpy as np

from zarm_geometry.kernels.compiled import brief
from zarm_planner.kernels.ramps import Ramps
from zarm_trajectory.arrays import Array

CLOSE = 1e-4
"""Samples are further apart than this (s; in a motion of more than 1 s, this share of it), so that what is left of rounded positions, divided by the cube
of the difference, is far below the jerk of the motion.
"""


@brief
def knots(ramps: Ramps, count: int, window: float, begin: float, fastest: Array, strongest: Array) -> Array:
    """The ascending times (k,) in s of the knots of the first `count` ramps, averaged over `window` s. The first and
    the last are the ends of the motion. It starts `begin` s into the ramps, and that moment is time 0.

    The ends of ramps are knots for all joints. The switching times within ramps only count for joints that get faster
    than `fastest` (dof,) in rad/s or accelerate more than `strongest` (dof,) in rad/s^2.
    """
    dof = ramps.position.shape[1]
    found = np.empty(2 * (1 + count * (1 + 2 * dof)))
    found[0], found[1] = -begin, window - begin
    n, end = 2, -begin
    for i in range(count):
        start, end = end, end + ramps.duration[i]
        found[n], found[n + 1] = end, end + window
        n += 2
        for j in range(dof):
            a = ramps.acceleration[i, j]
            if abs(a) > strongest[j] or abs(ramps.velocity[i, j] + a * ramps.first[i, j]) > fastest[j]:
                found[n], found[n + 1] = start + ramps.first[i, j], end - ramps.last[i, j]
                found[n + 2], found[n + 3] = found[n] + window, found[n + 1] + window
                n += 4
    times = np.sort(found[:n])
    last = times[n - 1]
    kept, times[0], close = 1, 0.0, CLOSE * max(1.0, last)
    for k in range(n):
        if times[k] > times[kept - 1] + close:
            times[kept] = times[k]
            kept += 1
    kept = max(kept, 2)
    times[kept - 1] = last
    return times[:kept]


@brief
def subdivided(knots: Array, factor: float, dt: float, most: int) -> Array:
    """Times (n,) from the first to the last of the ascending `knots` (k,) in s, including all of these; stretched by
    `factor`, they are at most `dt` s apart. Empty if there would be more than `most`.
    """
    total = 1.0
    for k in range(knots.shape[0] - 1):
        total += max(1.0, np.ceil((knots[k + 1] - knots[k]) * factor / dt - 1e-6))
    if not total <= most + 1:
        return np.empty(0)
    times = np.empty(int(total))
    n = 0
    for k in range(knots.shape[0] - 1):
        step = knots[k + 1] - knots[k]
        pieces = int(max(1.0, np.ceil(step * factor / dt - 1e-6)))
        for piece in range(pieces):
            times[n] = knots[k] + piece * (step / pieces)
            n += 1
    times[n] = knots[-1]
    return times


@brief
def sample_average(ramps: Ramps, count: int, window: float, t: Array, out: Array) -> None:
    """Write to `out` (3, n, dof) position, velocity and acceleration of the first `count` ramps at the ascending times
    `t` (n,) in s, each averaged over the preceding `window` s; before and after the ramps the robot rests.
    """
    steps = 3 * count
    begin, area = np.empty(steps), np.empty(steps)
    position, velocity, acceleration = np.empty(steps), np.empty(steps), np.empty(steps)
    for j in range(ramps.position.shape[1]):
        clock, total = 0.0, 0.0
        for s in range(steps):  # piecewise constant acceleration: up, level, down
            i, phase = s // 3, s % 3
            if phase == 0:
                p, v, a, h = ramps.position[i, j], ramps.velocity[i, j], ramps.acceleration[i, j], ramps.first[i, j]
            elif phase == 1:
                a, h = 0.0, max(ramps.duration[i] - ramps.first[i, j] - ramps.last[i, j], 0.0)
            else:
                a, h = -ramps.acceleration[i, j], ramps.last[i, j]
            begin[s], area[s], position[s], velocity[s], acceleration[s] = clock, total, p, v, a
            clock += h
            total += h * (p + h * (v / 2 + h * a / 6))
            p += h * (v + h * a / 2)
            v += h * a
        for sign, shift in ((1.0, 0.0), (-1.0, window)):
            s = 0
            for k in range(t.shape[0]):
                inside = min(max(t[k] - shift, 0.0), clock)
                while s < steps - 1 and inside >= begin[s + 1]:
                    s += 1
                x, v, a = inside - begin[s], velocity[s], acceleration[s]
                p = position[s] + x * (v + x * a / 2)
                outside = (t[k] - shift - inside) * p
                values = (area[s] + x * (position[s] + x * (v / 2 + x * a / 6)) + outside, p, v + x * a)
                for row in range(3):
                    if sign > 0.0:
                        out[row, k, j] = values[row]
                    else:
                        out[row, k, j] = (out[row, k, j] - values[row]) / window
