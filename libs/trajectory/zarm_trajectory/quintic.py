"""Quintic polynomials: a timed trajectory between two of its samples.

Coefficients are arrays (6, N, J), lowest power first, of N segments of J joints, each over its own time scaled to [0, 1].
"""

from __future__ import annotations

from collections.abc import Sequence
from math import comb

import numpy as np

from zarm_trajectory.arrays import Array

_HERMITE = np.array(
    # way    v0    a0    v1    a1
    [
        [10.0, -6.0, -1.5, -4.0, 0.5],
        [-15.0, 8.0, 1.5, 7.0, -1.0],
        [6.0, -3.0, -0.5, -3.0, 0.5],
    ]
)
"""The three highest coefficients of the quintic on [0, 1] over a displacement, from velocity and acceleration at its
start to those at its end (Hermite interpolation: six conditions, six coefficients).
"""


_ALL = np.zeros((6, 6))
"""All six coefficients, over the start and the same conditions."""
_ALL[[0, 1, 2], [0, 2, 3]] = 1.0, 1.0, 0.5
_ALL[3:, 1:] = _HERMITE


def coefficients(begin: Array, end: Array, step: Array) -> Array:
    """Coefficients (6, N, J) of the quintics over times of length `step` (N,) s.

    `begin` and `end` (3, N, J) are positions, velocities and accelerations at both ends.
    """
    h = step[:, None]
    v0, a0, v1, a1 = begin[1] * h, begin[2] * h**2, end[1] * h, end[2] * h**2
    conditions = np.stack((end[0] - begin[0], v0, a0, v1, a1))
    highest = (_HERMITE @ conditions.reshape(5, -1)).reshape(3, *v0.shape)
    return np.concatenate((np.stack((begin[0], v0, a0 / 2)), highest))


def state(begin: Sequence[Array], end: Sequence[Array], step: float, u: float) -> Array:
    """Position, velocity and acceleration (3, J) at `u` in [0, 1] of one quintic over `step` s, from those at both
    ends, each (J,).
    """
    (p0, v0, a0), (p1, v1, a1) = begin, end
    u2, u3, u4 = u * u, u**3, u**4
    powers = np.array(
        (
            (1.0, u, u2, u3, u4, u4 * u),
            (0.0, 1.0 / step, 2 * u / step, 3 * u2 / step, 4 * u3 / step, 5 * u4 / step),
            (0.0, 0.0, 2 / step**2, 6 * u / step**2, 12 * u2 / step**2, 20 * u3 / step**2),
        )
    )
    h, h2 = step, step * step
    found: Array = powers @ _ALL @ np.array((p0, p1 - p0, v0 * h, a0 * h2, v1 * h, a1 * h2))
    return found


def derivative(polynomials: Array) -> Array:
    """Coefficients (D, ...), lowest power first, of the derivatives of polynomials (D+1, ...)."""
    powers = np.arange(1.0, len(polynomials)).reshape(-1, *(1,) * (polynomials.ndim - 1))
    slope: Array = polynomials[1:] * powers
    return slope


def values(polynomials: Array, u: Array) -> Array:
    """Values of polynomials (D+1, ...) at `u` (...) in [0, 1], by Horner's rule."""
    result: Array = np.zeros_like(u) + polynomials[-1]
    for coefficient in polynomials[-2::-1]:
        result *= u
        result += coefficient
    return result


def states(polynomials: Array, u: Array) -> tuple[Array, Array, Array]:
    """Values, slopes and second derivatives of polynomials (D+1, ...) at `u` in [0, 1], by Horner's rule."""
    value = np.zeros(polynomials.shape[1:]) + polynomials[-1]
    slope, bend = np.zeros_like(value), np.zeros_like(value)
    for coefficient in polynomials[-2::-1]:
        bend = bend * u + slope
        slope = slope * u + value
        value = value * u + coefficient
    return value, slope, 2 * bend


def control_points(polynomials: Array) -> Array:
    """Control points (D+1, ...) of polynomials (D+1, ...), D from 2 to 5: a Bezier curve lies in the hull of its control points."""
    found: Array = (_BERNSTEIN[len(polynomials) - 1] @ polynomials.reshape(len(polynomials), -1)).reshape(
        polynomials.shape
    )
    return found


def extremes(polynomials: Array) -> Array:
    """Values (D+1, ...) of polynomials (D+1, ...) on [0, 1], including their minimum and maximum."""
    return values(polynomials, _ends_and_turns(polynomials))


def _ends_and_turns(polynomials: Array) -> Array:
    """Points (D+1, ...) in [0, 1], in order: both ends, and all extrema of a polynomial of degree D.

    Between two extrema of its slope the slope is monotone, so bisection finds the single zero that it may have there.
    Without a zero the bisection ends at a border of the interval, which does no harm.
    """
    ends = np.zeros_like(polynomials[:1]), np.ones_like(polynomials[:1])
    if len(polynomials) == 2:
        return np.concatenate(ends)
    slope = derivative(polynomials)
    knots = _ends_and_turns(slope)
    low, high = knots[:-1], knots[1:]
    sign = np.sign(values(slope, low))
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        before = np.sign(values(slope, middle)) == sign
        low, high = np.where(before, middle, low), np.where(before, high, middle)
    return np.concatenate((ends[0], low, ends[1]))


_HALVINGS = 16
_BERNSTEIN = {
    degree: np.array([[comb(i, k) / comb(degree, k) for k in range(degree + 1)] for i in range(degree + 1)])
    for degree in (2, 3, 4, 5)
}
"""From powers to control points: b_i = sum over k <= i of (i over k) / (D over k) c_k (Farouki and Rajan 1987)."""
