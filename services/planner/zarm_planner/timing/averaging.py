"""Chooses how much of its limits a motion uses: the averaging time that bounds jerk, and the acceleration that goes with it.

A moving average over a window of w s turns a change of acceleration by 2 a into a jerk of 2 a / w. So within a jerk limit j it allows an
acceleration of j w / 2: a longer window makes the ramps shorter, and the motion w longer. The best window depends on the way: where it
allows less than the acceleration limit, more acceleration would only cost time, and is not used.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from zarm_planner.kernels.averaging import best_window
from zarm_trajectory.arrays import Array

DEVIATION = 1e-3
"""Largest deviation (rad) of each joint when passing a via."""
MIN_AVERAGING_TIME = 0.1
"""Least averaging time, in samples."""


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
        rates: Array,
        shortest: float,
        *,
        deviation: float = np.inf,
        begun: Array | None = None,
        velocity: Array | None = None,
    ) -> Self:
        """The fastest for joints that move by `ways` (dof,) in rad from rest to rest, within limits `rates` (3, dof) of velocity,
        acceleration and jerk; the window takes at least `shortest` s.

        Averaging moves no joint more than `deviation` (rad) off the motion. In the middle of a window w, the average of a motion differs
        from it by at most a w^2 / 24, with a the largest acceleration: |x(t + s) - x(t) - v(t) s| <= a s^2 / 2, averaged over s from -w / 2
        to w / 2. `begun` (dof,) in rad/s^2 is an acceleration before the motion that the window has to take away; `velocity` (dof,) in
        rad/s one to be braked.

        The duration never grows with a limit: it is the shortest of all windows, and each allows as much with a higher limit. A limit out
        of reach changes nothing at all.
        """
        none = np.zeros_like(ways)
        begun, velocity = none if begun is None else np.abs(begun), none if velocity is None else np.abs(velocity)
        return cls(*best_window(ways, rates, shortest, begun, velocity, deviation))


def total_ways(path: Array) -> Array:
    """How far (dof,) each joint turns along a path (n, dof), back and forth."""
    return np.asarray(np.abs(np.diff(path, axis=0)).sum(axis=0))
