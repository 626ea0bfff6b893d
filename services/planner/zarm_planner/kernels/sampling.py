"""Samples of a motion that is averaged over time."""

from __future__ import annotations

import numpy as np

from zarm_geometry.kernels.compiled import brief
from zarm_planner.kernels.ramps import Array, Ramps


@brief
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
