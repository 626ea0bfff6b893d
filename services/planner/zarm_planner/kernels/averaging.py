"""Which averaging time makes a motion the shortest."""

from __future__ import annotations

import math

import numpy as np

from zarm_geometry.kernels.compiled import brief, inlined
from zarm_trajectory.arrays import Array

_LONGEST = 1e6
"""Longest averaging time (s) considered."""
_POINTS = 33
"""Windows compared at once, ..."""
_ROUNDS = 5
"""... each time between the neighbours of the best: after this many the window is known to 0.01 %, and the duration to the
square of it.
"""
_LEAST_SHARE = 1e-3
"""Least averaging time as a share of the motion: samples are differences of integrals over the whole motion, which lose as
many digits as the window is shorter.
"""
_STEP = 1e-6
"""Share of a window that shows whether a shorter one is better."""


@inlined
def _allowed(window: float, strongest: float, jerk: float, begun: float, deviation: float) -> float:
    """The acceleration of a joint with this window."""
    most = min(0.5 * jerk * window, jerk * window - begun, strongest)
    return min(most, 24.0 * deviation / (window * window))


@inlined
def _of_use(strongest: float, fastest: float, way: float, shortest: float) -> float:
    """As much of an acceleration limit as a joint from rest to rest can use in ramps of at least the `shortest` window: in
    shorter ones samples do not follow it.
    """
    return min(strongest, fastest / shortest, way / (shortest * shortest))


@inlined
def _duration(window: float, ways: Array, rates: Array, begun: Array, speed: Array, deviation: float) -> float:
    """The least duration (s) with this window: that of the slowest joint, which accelerates and brakes, and the window."""
    longest = 0.0
    for j in range(ways.shape[0]):
        if ways[j] == 0.0 and speed[j] == 0.0 and begun[j] == 0.0:
            continue
        fastest = rates[0, j]
        a = _allowed(window, rates[1, j], rates[2, j], begun[j], deviation)
        if a <= 0.0:
            return math.inf
        ramps = 2.0 * math.sqrt(ways[j] / a) if ways[j] * a < fastest * fastest else ways[j] / fastest + fastest / a
        longest = max(longest, ramps, speed[j] / a)
    return longest + window


@brief
def best_window(
    ways: Array, rates: Array, shortest: float, begun: Array, speed: Array, deviation: float
) -> tuple[float, Array, Array, float]:
    """See `timing.averaging.Averaging`: the window, the velocities and accelerations (dof,) used with it, and the duration.

    `rates` (3, dof) are the limits of velocity, acceleration and jerk.
    """
    joints = ways.shape[0]
    rates = rates.copy()
    for j in range(joints):
        shortest = max(shortest, _LEAST_SHARE * ways[j] / rates[0, j])
    for j in range(joints):
        if ways[j] > 0.0 and speed[j] == 0.0 and begun[j] == 0.0:
            rates[1, j] = _of_use(rates[1, j], rates[0, j], ways[j], shortest)
    full = shortest  # the acceleration limits allow no use of a longer one
    for j in range(joints):
        if ways[j] > 0.0 or speed[j] > 0.0 or begun[j] > 0.0:
            full = max(full, (rates[1, j] + max(rates[1, j], begun[j])) / rates[2, j])
    full = min(full, _LONGEST)
    best, duration = full, _duration(full, ways, rates, begun, speed, deviation)
    if full > shortest and duration >= _duration((1.0 - _STEP) * full, ways, rates, begun, speed, deviation):
        low, high = math.log(shortest), math.log(_LONGEST)
        for _ in range(_ROUNDS):
            step, nearest, least = (high - low) / (_POINTS - 1), 0, math.inf
            for k in range(_POINTS):
                there = _duration(math.exp(low + k * step), ways, rates, begun, speed, deviation)
                if there < least:
                    nearest, least = k, there
            low, high = low + max(nearest - 1, 0) * step, low + min(nearest + 1, _POINTS - 1) * step
        best = min(math.exp(0.5 * (low + high)), full)
        duration = _duration(best, ways, rates, begun, speed, deviation)
    fastest, strongest = np.empty(joints), np.empty(joints)
    for j in range(joints):
        strongest[j] = _allowed(best, rates[1, j], rates[2, j], begun[j], deviation)
        # A joint that accelerates all this time and brakes again is at most half as fast.
        reached = strongest[j] * (duration - best) + speed[j]
        fastest[j] = min(rates[0, j], reached) if duration > best else rates[0, j]
    return best, fastest, strongest, duration


@brief
def least_duration(start: Array, goals: Array, rates: Array, shortest: float) -> float:
    """The least duration (s) of `best_window` from `start` (dof,) to any of `goals` (n, dof)."""
    least, none = math.inf, np.zeros(start.shape[0])
    for i in range(goals.shape[0]):
        ways = np.abs(goals[i] - start)
        least = min(least, best_window(ways, rates, shortest, none, none, math.inf)[3])
    return least
