"""Time-optimal path parameterization by reachability analysis.

The method is TOPPRA's (Pham and Pham, "A New Approach to Time-Optimal Path Parameterization Based on Reachability Analysis",
2018). Its linear programs have two variables, and one of them is only bounded, so that Newton's method solves each exactly in a
few steps; the solvers that come with TOPPRA take a hundred times as long.
"""

from __future__ import annotations

import numpy as np

from zarm_geometry.kernels.compiled import brief, inlined
from zarm_trajectory.arrays import Array

_STEPS = 40
"""Most steps of Newton's method: each leaves a pair of bounds behind, and two or three are usual."""
_INSET = 1e-4
"""Share by which squares stay below what is reachable: at the very edge, the next one may have to be 0."""
_ZERO = 1e-9
"""A rate that counts as 0, and a share by which bounds may cross, which is rounding."""


@inlined
def _accelerations(
    square: float, needs: Array, i: int, low: float, high: float, slope: float
) -> tuple[float, float, float, float]:
    """The smallest and the largest acceleration along the path, from `low` to `high`, which change by `slope` per square of velocity,
    with which all needs of the grid point `i` are met at the `square` of velocity; and by how much these change.
    """
    low_slope, high_slope = slope, slope
    for r in range(needs.shape[2]):
        fixed, rate = needs[0, i, r], needs[1, i, r]
        if abs(rate) <= _ZERO:
            continue
        below, above = (needs[2, i, r] - fixed * square) / rate, (needs[3, i, r] - fixed * square) / rate
        if rate < 0.0:
            below, above = above, below
        if below > low:
            low, low_slope = below, -fixed / rate
        if above < high:
            high, high_slope = above, -fixed / rate
    return low, high, low_slope, high_slope


@inlined
def _largest_square(needs: Array, i: int, most: float, step: float, following: float) -> float:
    """The largest square of velocity, at most `most`, from which `step` leads to one from 0 to `following`."""
    square = most
    for r in range(needs.shape[2]):
        if abs(needs[1, i, r]) <= _ZERO:
            fixed = needs[0, i, r]
            if fixed > _ZERO:
                square = min(square, needs[3, i, r] / fixed)
            elif fixed < -_ZERO:
                square = min(square, needs[2, i, r] / fixed)
    for _ in range(_STEPS):
        low, high, low_slope, high_slope = _accelerations(
            square, needs, i, -square / step, (following - square) / step, -1.0 / step
        )
        gap = high - low  # concave in the square: the line of the two bounds leads to where it is at most 0
        if gap >= -_ZERO * max(1.0, abs(high)):
            return square
        slope = high_slope - low_slope
        if slope >= 0.0:
            return 0.0
        square = max(square - gap / slope, 0.0)
    return square


@brief
def fastest_squares(grid: Array, needs: Array, most: Array, least: float) -> Array:
    """The largest squares (n,) of the velocity along a path, at most `most` (n,), at the points of a `grid` (n,), between which they are
    interpolated linearly.

    `needs` (4, n, rows) has what each quantity needs per square of velocity, per acceleration along the path, and its bounds: one
    that is 0 or less, and one that is 0 or more. Where nothing meets them, the square is `least`.
    """
    count = grid.shape[0]
    square = most.copy()
    for i in range(count - 2, -1, -1):  # from where the rest can be done
        step = 2.0 * (grid[i + 1] - grid[i])
        square[i] = max(_largest_square(needs, i, most[i], step, square[i + 1]), least)
        if square[i] < most[i]:
            square[i] *= 1.0 - _INSET
    for i in range(count - 1):
        step = 2.0 * (grid[i + 1] - grid[i])
        _, high, _, _ = _accelerations(square[i], needs, i, -np.inf, (square[i + 1] - square[i]) / step, 0.0)
        square[i + 1] = max(min(square[i + 1], square[i] + step * high), least)
    return square
