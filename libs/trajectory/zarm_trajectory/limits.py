"""What a robot's joints may do, held against the polynomials that a motion is made of, between its samples too."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from math import comb

import numpy as np

from zarm_contract.errors import ExecutionRefused
from zarm_contract.robot import Robot
from zarm_trajectory.trajectory import Array, TimedTrajectory

LIMIT_TOLERANCE = 1.01
"""Velocity and acceleration may be above their limits by this factor: what interpolation adds between samples."""
POSITION_TOLERANCE = 1e-4
"""Positions may be outside their limits by this much, rad: rounding, and interpolation between samples."""
_HALVINGS = 16
_BERNSTEIN = {
    degree: np.array([[comb(i, k) / comb(degree, k) for k in range(degree + 1)] for i in range(degree + 1)])
    for degree in (2, 3, 4, 5)
}
"""From powers to control points: b_i = sum over k <= i of (i over k) / (D over k) c_k (Farouki and Rajan 1987)."""


_Values = Callable[[Array], Array]
"""Of polynomials (D+1, ...) on [0, 1], lowest power first, values between which all of each polynomial lies."""


@dataclass(frozen=True)
class _Curve:
    """One quantity of N segments: `values` (points, N, J) with the extremes among them, in `offset` +- `limit` (J,)."""

    name: str
    unit: str
    values: Array
    offset: Array
    limit: Array

    @property
    def inside(self) -> Array:
        """Which values are inside."""
        return np.asarray(np.abs(self.values - self.offset) <= self.limit)


class Limits:
    """The limits of position (rad), velocity (rad/s), acceleration (rad/s^2) and jerk (rad/s^3) of a robot's joints.

    That of jerk is held by what the executor makes itself. Whoever sends a trajectory may change the acceleration at once.
    """

    def __init__(self, robot: Robot) -> None:
        self._joints = robot.descriptor.joints
        self._lower, self._upper = np.array(robot.lower), np.array(robot.upper)
        self._velocity = np.array(robot.descriptor.cspace.velocity)
        self._acceleration = np.array(robot.descriptor.cspace.acceleration)
        self._jerk = np.array(robot.descriptor.cspace.jerk)

    def check(self, path: TimedTrajectory) -> None:
        """Raises ExecutionRefused (`limit_violated`) that names the joint furthest outside; jerk is not looked at."""
        if _inside(self._curves(path.coefficients, path.steps, _hull)).all():
            return
        for curve in self._curves(path.coefficients, path.steps, _extremes):
            if curve.inside.all():
                continue
            excess = np.nan_to_num(np.abs(curve.values - curve.offset) / curve.limit, nan=np.inf)
            point, segment, joint = np.unravel_index(int(excess.argmax()), excess.shape)
            name, limit = curve.name, f"{curve.limit[joint] / LIMIT_TOLERANCE:g}"
            bounds = f"{self._lower[joint]:g} to {self._upper[joint]:g}" if name == "position" else limit
            raise ExecutionRefused(
                f"the {name} of {self._joints[joint]} reaches {curve.values[point, segment, joint]:.4g} {curve.unit} near "
                f"{path.time[segment]:.2f} s, outside its limit {bounds}; plan again with the limits of this robot",
                code="limit_violated",
                joint=self._joints[joint],
                field=f"trajectory.{name}",
            )

    def first_inside(self, coefficients: Array, steps: Array) -> int | None:
        """The first of these segments, coefficients (N, 6, J) over the times (N,) s, that is inside every limit, if any."""
        # With a tenth of the work many are seen to be inside for certain, but not all that are.
        certain = np.flatnonzero(_inside(self._all_curves(coefficients, steps, _hull)))
        before = int(certain[0]) if certain.size else len(steps)
        if before == 0:
            return 0
        inside = np.flatnonzero(_inside(self._all_curves(coefficients[:before], steps[:before], _extremes)))
        return int(inside[0]) if inside.size else before if certain.size else None

    def _all_curves(self, coefficients: Array, steps: Array, values: _Values) -> Iterator[_Curve]:
        yield from self._curves(coefficients, steps, values)
        jerk = np.moveaxis(coefficients, 1, 0)  # (6, segments, J)
        for _ in range(3):
            jerk = _derivative(jerk) / steps[:, None]
        limit = self._jerk * LIMIT_TOLERANCE
        yield _Curve("jerk", "rad/s^3", values(jerk), np.zeros_like(limit), limit)

    def _curves(self, coefficients: Array, steps: Array, values: _Values) -> Iterator[_Curve]:
        position = np.moveaxis(coefficients, 1, 0)  # (6, segments, J)
        velocity = _derivative(position) / steps[:, None]
        acceleration = _derivative(velocity) / steps[:, None]
        middle, reach = (self._lower + self._upper) / 2, (self._upper - self._lower) / 2 + POSITION_TOLERANCE
        none = np.zeros_like(middle)
        yield _Curve("position", "rad", values(position), middle, reach)
        yield _Curve("velocity", "rad/s", values(velocity), none, self._velocity * LIMIT_TOLERANCE)
        yield _Curve("acceleration", "rad/s^2", values(acceleration), none, self._acceleration * LIMIT_TOLERANCE)


def _inside(curves: Iterable[_Curve]) -> Array:
    """Which (N,) segments are inside."""
    return np.asarray(np.logical_and.reduce([curve.inside.all(axis=(0, 2)) for curve in curves]))


def _derivative(polynomials: Array) -> Array:
    """Coefficients (D, ...), lowest power first, of the derivatives of polynomials (D+1, ...)."""
    powers = np.arange(1, len(polynomials)).reshape(-1, *(1,) * (polynomials.ndim - 1))
    slope: Array = polynomials[1:] * powers
    return slope


def _value(polynomials: Array, u: Array) -> Array:
    result: Array = np.zeros_like(u) + polynomials[-1]
    for coefficient in polynomials[-2::-1]:
        result = result * u + coefficient
    return result


def _hull(polynomials: Array) -> Array:
    """Control points (D+1, ...) of polynomials (D+1, ...): a Bezier curve lies in the hull of its control points."""
    degree = len(polynomials) - 1
    points: Array = np.einsum("ik,k...->i...", _BERNSTEIN[degree], polynomials)
    return points


def _extremes(polynomials: Array) -> Array:
    """Values (D+1, ...) of polynomials (D+1, ...) on [0, 1], their least and greatest among them."""
    return _value(polynomials, _ends_and_turns(polynomials))


def _ends_and_turns(polynomials: Array) -> Array:
    """Points (D+1, ...) in [0, 1], in order: both ends, and each at which a polynomial of degree D turns.

    Between two points at which its slope turns the slope is monotone, so bisection finds the one zero it may have there.
    Where it has none the bisection ends at a border of the interval, which does no harm.
    """
    ends = np.zeros_like(polynomials[:1]), np.ones_like(polynomials[:1])
    if len(polynomials) == 2:
        return np.concatenate(ends)
    slope = _derivative(polynomials)
    knots = _ends_and_turns(slope)
    low, high = knots[:-1], knots[1:]
    sign = np.sign(_value(slope, low))
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        before = np.sign(_value(slope, middle)) == sign
        low, high = np.where(before, middle, low), np.where(before, high, middle)
    return np.concatenate((ends[0], low, ends[1]))
