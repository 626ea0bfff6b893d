"""Checks a timed trajectory against the joint limits, also between its samples."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from zarm_contract.errors import ExecutionRefused
from zarm_contract.robot import RobotDescription
from zarm_trajectory import quintic
from zarm_trajectory.arrays import Array
from zarm_trajectory.trajectory import TimedTrajectory

LIMIT_TOLERANCE = 1.01
"""Factor by which velocity and acceleration of external trajectories may exceed their limits, due to interpolation."""
POSITION_TOLERANCE = 1e-4
"""Amount (rad) by which positions may exceed their limits, due to rounding and interpolation between samples."""
_Values = Callable[[Array], Array]
"""Maps polynomials (D+1, ...) on [0, 1], lowest power first, to values that enclose each polynomial."""


@dataclass(frozen=True)
class _Curve:
    """One quantity of N segments: `values` (points, N, J), which include the extremes, must be within `limit` (J,) of
    `offset`.
    """

    name: str
    unit: str
    values: Array
    offset: Array
    limit: Array

    @property
    def inside(self) -> Array:
        """Which values are inside."""
        return np.asarray(np.abs(self.values - self.offset) <= self.limit)


@dataclass(frozen=True, eq=False)
class Limits:
    """The limits of `joints`, each (J,): positions from `lower` to `upper` (rad), `velocity` (rad/s), `acceleration`
    (rad/s^2) and `jerk` (rad/s^3).

    zarm's own motions keep the jerk limit. External trajectories may change the acceleration instantaneously.
    """

    joints: tuple[str, ...]
    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array
    jerk: Array

    @classmethod
    def of(cls, robot: RobotDescription, velocity_scale: float = 1.0, acceleration_scale: float = 1.0) -> Self:
        """The limits of the descriptor, scaled."""
        cspace = robot.descriptor.cspace
        return cls(
            robot.descriptor.joints,
            np.array(robot.lower),
            np.array(robot.upper),
            np.array(cspace.velocity) * velocity_scale,
            np.array(cspace.acceleration) * acceleration_scale,
            np.array(cspace.jerk),
        )

    def part(self, joints: NDArray[np.intp]) -> Self:
        """The limits of the joints with these indices (n,)."""
        return type(self)(
            tuple(self.joints[k] for k in joints),
            self.lower[joints],
            self.upper[joints],
            self.velocity[joints],
            self.acceleration[joints],
            self.jerk[joints],
        )

    @cached_property
    def rates(self) -> Array:
        """The limits (3, J) of velocity, acceleration and jerk."""
        return np.stack((self.velocity, self.acceleration, self.jerk))

    def check(self, trajectory: TimedTrajectory) -> None:
        """Raises ExecutionRefused (`limit_violated`) that names the joint furthest outside; jerk is not checked."""
        coefficients, steps = trajectory.coefficients, trajectory.steps
        if _inside(self._curves(coefficients, steps, quintic.control_points)).all():
            return
        for curve in self._curves(coefficients, steps, quintic.extremes):
            if curve.inside.all():
                continue
            excess = np.nan_to_num(np.abs(curve.values - curve.offset) / curve.limit, nan=np.inf)
            point, segment, joint = np.unravel_index(int(excess.argmax()), excess.shape)
            name, limit = curve.name, f"{curve.limit[joint] / LIMIT_TOLERANCE:g}"
            bounds = f"{self.lower[joint]:g} to {self.upper[joint]:g}" if name == "position" else limit
            raise ExecutionRefused(
                f"the {name} of {self.joints[joint]} reaches {curve.values[point, segment, joint]:.4g} {curve.unit} near "
                f"{trajectory.time[segment]:.2f} s, outside its limit {bounds}; plan again with the limits of this robot",
                code="limit_violated",
                joint=self.joints[joint],
                field=f"trajectory.{name}",
            )

    def first_inside(self, coefficients: Array, steps: Array) -> int | None:
        """The first of these segments, coefficients (6, N, J) over the times (N,) s, that is inside every limit, if
        any.
        """
        # A tenth of the work proves many segments to be inside, but not all that are.
        certain = np.flatnonzero(_inside(self._all_curves(coefficients, steps, quintic.control_points)))
        before = int(certain[0]) if certain.size else len(steps)
        if before == 0:
            return 0
        inside = np.flatnonzero(_inside(self._all_curves(coefficients[:, :before], steps[:before], quintic.extremes)))
        return int(inside[0]) if inside.size else before if certain.size else None

    def _all_curves(self, coefficients: Array, steps: Array, values: _Values) -> Iterator[_Curve]:
        yield from self._curves(coefficients, steps, values)
        jerk = coefficients
        for _ in range(3):
            jerk = quintic.derivative(jerk) / steps[:, None]
        limit = self.jerk * LIMIT_TOLERANCE
        yield _Curve("jerk", "rad/s^3", values(jerk), np.zeros_like(limit), limit)

    def _curves(self, position: Array, steps: Array, values: _Values) -> Iterator[_Curve]:
        velocity = quintic.derivative(position) / steps[:, None]
        acceleration = quintic.derivative(velocity) / steps[:, None]
        reach = (self.upper - self.lower) / 2 + POSITION_TOLERANCE
        none = np.zeros_like(reach)
        middle = np.add(self.lower, self.upper, out=none.copy(), where=np.isfinite(reach)) / 2
        yield _Curve("position", "rad", values(position), middle, reach)
        yield _Curve("velocity", "rad/s", values(velocity), none, self.velocity * LIMIT_TOLERANCE)
        yield _Curve("acceleration", "rad/s^2", values(acceleration), none, self.acceleration * LIMIT_TOLERANCE)


def _inside(curves: Iterable[_Curve]) -> Array:
    """Which (N,) segments are inside."""
    return np.asarray(np.logical_and.reduce([curve.inside.all(axis=(0, 2)) for curve in curves]))
