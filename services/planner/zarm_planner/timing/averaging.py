"""Chooses how much of its limits a motion uses: the averaging time that bounds jerk, and the acceleration that goes with it.

A moving average over a window of w s turns a change of acceleration by 2 a into a jerk of 2 a / w. So within a jerk limit j it allows an
acceleration of j w / 2: a longer window makes the ramps shorter, and the motion w longer. The best window depends on the way: where it
allows less than the acceleration limit, more acceleration would only cost time, and is not used.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from zarm_trajectory.limits import Limits
from zarm_trajectory.quintic import Array

DEVIATION = 1e-3
"""Largest deviation (rad) of each joint when passing a via."""
SHORTEST = 0.1
"""Least averaging time, in samples."""
_LONGEST = 1e6
"""Longest averaging time (s) considered."""
_POINTS = 33
"""Windows compared at once, ..."""
_ROUNDS = 5
"""... each time between the neighbours of the best: after this many the window is known to 0.01 %, and the duration to the square of it."""
_STEP = 1e-6
"""Share of a window that shows whether a shorter one is better."""


@dataclass(frozen=True, eq=False)
class Averaging:
    """What a motion uses of the limits: an averaging time of `window` s, the `velocity` (dof,) in rad/s and the `acceleration` (dof,) in
    rad/s^2.

    `duration` (s) bounds the duration of the motion from below, averaging included.
    """

    window: float
    velocity: Array
    acceleration: Array
    duration: float

    @classmethod
    def of(
        cls,
        ways: Array,
        limits: Limits,
        shortest: float,
        *,
        deviation: float = np.inf,
        begun: Array | None = None,
        velocity: Array | None = None,
    ) -> Averaging:
        """The fastest for joints that move by `ways` (dof,) in rad from rest to rest; the window takes at least `shortest` s.

        Averaging moves no joint more than `deviation` (rad) off the motion. In the middle of a window w, the average of a motion differs
        from it by at most a w^2 / 24, with a the largest acceleration: |x(t + s) - x(t) - v(t) s| <= a s^2 / 2, averaged over s from -w / 2
        to w / 2. `begun` (dof,) in rad/s^2 is an acceleration before the motion that the window has to take away; `velocity` (dof,) in
        rad/s one to be braked.

        The duration never grows with a limit: it is the shortest of all windows, and each allows as much with a higher limit. A limit out
        of reach changes nothing at all.
        """
        return of_rates(ways, limits.rates, shortest, deviation=deviation, begun=begun, velocity=velocity)


def of_rates(
    ways: Array,
    rates: Array,
    shortest: float,
    *,
    deviation: float = np.inf,
    begun: Array | None = None,
    velocity: Array | None = None,
) -> Averaging:
    """As `Averaging.of`, for limits (3, dof) of velocity, acceleration and jerk."""
    fastest, strongest, jerk = rates
    before = np.zeros_like(ways) if begun is None else np.abs(begun)
    fast = np.zeros_like(ways) if velocity is None else np.abs(velocity)

    def allowed(window: Array) -> Array:
        """The accelerations (n, dof) with each of the windows (n,)."""
        w = window[:, None]
        most = np.minimum(np.minimum(0.5 * jerk * w, jerk * w - before), strongest)
        return np.asarray(np.minimum(most, 24.0 * deviation / (w * w)) if deviation < np.inf else most)

    def ramps(a: Array) -> Array:
        """The least time (n,) with accelerations (n, dof), before averaging."""
        usable = np.maximum(a, 1e-300)
        time = np.where(ways * usable < fastest**2, 2.0 * np.sqrt(ways / usable), ways / fastest + fastest / usable)
        return np.asarray(np.where(a > 0.0, np.maximum(time, fast / usable), np.inf).max(axis=1))

    moving = (ways > 0.0) | (fast > 0.0) | (before > 0.0)
    full = float(((strongest + np.maximum(strongest, before)) / jerk).max(initial=0.0, where=moving))
    full = min(max(full, shortest), _LONGEST)  # the acceleration limits allow no use of a longer one
    near = np.array((full, (1.0 - _STEP) * full))
    first, second = ramps(allowed(near)) + near
    best = full
    if full > shortest and not first < second:
        low, high = np.log(shortest), np.log(_LONGEST)
        for _ in range(_ROUNDS):
            windows = np.linspace(low, high, _POINTS)
            k = int(np.argmin(ramps(allowed(np.exp(windows))) + np.exp(windows)))
            low, high = windows[max(k - 1, 0)], windows[min(k + 1, _POINTS - 1)]
        best = min(float(np.exp(windows[k])), full)
    window = np.array((best,))
    acceleration = allowed(window)
    time = float(ramps(acceleration)[0])
    # A joint that accelerates all this time and brakes again is at most half as fast.
    reached = acceleration[0] * time + fast if time > 0.0 else fastest
    return Averaging(best, np.minimum(fastest, reached), acceleration[0], time + best)


def total_ways(path: Array) -> Array:
    """How far (dof,) each joint turns along a path (n, dof), back and forth."""
    return np.asarray(np.abs(np.diff(path, axis=0)).sum(axis=0))
