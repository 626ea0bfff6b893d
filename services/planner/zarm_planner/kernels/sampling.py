"""Samples of a motion that is averaged over time, and how far samples use the limits."""

from __future__ import annotations

import math

import numpy as np

from zarm_planner.kernels.compiled import kernel
from zarm_planner.kernels.ramps import Array, Ramps

_CHECKS = 8
"""Moments per interval between samples at which velocity and acceleration are checked."""


@kernel
def sample_average(ramps: Ramps, count: int, window: float, t: Array, out: Array) -> None:
    """Position, velocity and acceleration (3, n, dof) at the ascending times `t` (n,) of the first `count` ramps, averaged
    over the last `window` s; before and after them the robot rests.
    """
    steps = 3 * count
    begin, area = np.empty(steps), np.empty(steps)
    position, velocity, acceleration = np.empty(steps), np.empty(steps), np.empty(steps)
    for j in range(ramps.position.shape[1]):
        clock, total = 0.0, 0.0
        for s in range(steps):  # stepwise constant acceleration: up, level, down
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


@kernel
def load(time: Array, position: Array, velocity: Array, acceleration: Array, limits: Array) -> float:
    """How far samples (n, dof) at `time` (n,) use the `limits` (3, dof) on velocity, acceleration and jerk, 1 being fully.

    Between samples the motion is the quintic that meets all three at both ends. Velocity and acceleration are taken there
    too, jerk as the mean from sample to sample. A motion slower by the result just keeps all limits.
    """
    fastest, strongest, sharpest = 0.0, 0.0, 0.0
    for i in range(time.shape[0] - 1):
        h = time[i + 1] - time[i]
        for j in range(position.shape[1]):
            v0, a0 = velocity[i, j] * h, acceleration[i, j] * h * h
            # With x from 0 to 1 the start fixes c0, c1 and c2 = a0 / 2; the end gives three equations for the others.
            p = position[i + 1, j] - position[i, j] - v0 - a0 / 2
            v = velocity[i + 1, j] * h - v0 - a0
            a = acceleration[i + 1, j] * h * h - a0
            c3, c4, c5 = 10 * p - 4 * v + a / 2, -15 * p + 7 * v - a, 6 * p - 3 * v + a / 2
            top, most = 0.0, 0.0
            for check in range(_CHECKS):
                x = check / _CHECKS
                top = max(top, abs(v0 + x * (a0 + x * (3 * c3 + x * (4 * c4 + x * 5 * c5)))))
                most = max(most, abs(a0 + x * (6 * c3 + x * (12 * c4 + x * 20 * c5))))
            fastest = max(fastest, top / (h * limits[0, j]))
            strongest = max(strongest, most / (h * h * limits[1, j]))
            sharpest = max(sharpest, abs(a / (h * h * h)) / limits[2, j])
    return float(max(fastest, math.sqrt(strongest), sharpest ** (1.0 / 3.0)))
