"""From joints at the stations of a curve to a motion with the tool speed that is asked for."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from scipy.interpolate import CubicSpline

from zarm_contract.messages import ToolMotion
from zarm_planner.cartesian.curve import ToolCurve
from zarm_planner.cartesian.joint_curve import PROGRESS, JointCurve, JointSection
from zarm_planner.kernels.quintic import segment_loads
from zarm_planner.timing.sampling import TOLERANCE, load, within
from zarm_planner.timing.time_parameterization import fastest_along, joined
from zarm_trajectory.arrays import Array
from zarm_trajectory.limits import Limits
from zarm_trajectory.trajectory import TimedTrajectory

_SAMPLING = 0.01
"""Longest interval (s) between samples."""
_ROUNDS = 8
"""How often the speed is lowered where it is too high, before the whole motion is slowed down."""
_JERK_SHARE = 0.7
"""Share of the permitted jerk that the curve may take at constant velocity."""
_AROUND = 0.01
"""s before and after a sample that is too fast where the speed is lowered, besides the averaging time."""
_FURTHER = 1.005
"""Factor by which speed is lowered further than the load says."""
_LITTLE = 0.003
"""Share by which limits may be exceeded where the whole motion is slowed down at once."""
_RAMP = 0.1
"""s in which the tool's acceleration grows to its full value."""
_RAMP_FACTOR = 2.0
"""Factor by which it may grow faster than that: no limit of the robot."""
_STEP = 0.004
"""s between two samples of how the tip advances."""
_AT_SPEED = 0.99
"""Share of a speed that counts as it."""


def time_along(curve: ToolCurve, joints: JointCurve, limits: Limits, dt: float) -> TimedTrajectory | None:
    """The motion along the curve of the joints, at rest at both ends and where the tool's curve rests; with PROGRESS more columns. None where
    the limits allow no motion.

    Raises InvalidRequest if the limits make the motion longer than a message holds.
    """
    parts = []
    for section in joints.sections:
        part = _timed(curve, section, limits, min(dt, _SAMPLING))
        if part is None:
            return None
        parts.append(part)
    return joined(parts)


def _timed(curve: ToolCurve, section: JointSection, limits: Limits, dt: float) -> TimedTrajectory | None:
    """The motion along a section.

    Where it exceeds a limit, which jerk does in corners, its speed is lowered there, and the rest stays as fast as asked.
    """
    stations, spline = section.stations, section.spline
    along = TimedTrajectory(stations - stations[0], section.rows, spline(stations, 1), spline(stations, 2))
    wide, judged = _with_tool(limits, curve), _with_tool(limits, curve, _RAMP_FACTOR)
    cap = _jerk_cap(spline, wide)
    for number in itertools.count(1):
        if (profile := fastest_along(along, wide, dt, cap=cap)) is None:
            break
        trajectory = profile.sample(1.0, dt)
        used = load(trajectory, judged)
        if used <= 1.0 + TOLERANCE:
            return trajectory
        if used <= 1.0 + _LITTLE or number == _ROUNDS:
            return within(partial(profile.sample, dt=dt), judged)
        cap = _lowered(cap, along.time, trajectory, profile.window, judged)
    return None


def _jerk_cap(spline: CubicSpline, limits: Limits) -> Array:
    """Velocities (n,) along a curve at its stations at which the curve itself, at constant velocity, takes _JERK_SHARE of
    the permitted jerk.
    """
    third = np.abs(6.0 * spline.c[0]) / limits.jerk  # of each piece, (n - 1, columns)
    most = third.max(axis=1)
    at_stations = np.maximum(np.append(most, 0.0), np.insert(most, 0, 0.0))
    return np.asarray(np.cbrt(_JERK_SHARE / np.maximum(at_stations, 1e-9)))


def _lowered(cap: Array, stations: Array, trajectory: TimedTrajectory, window: float, limits: Limits) -> Array:
    """The velocities `cap` (n,) at the stations, lower where a trajectory with an averaging `window` (s) exceeds limits."""
    loads = np.empty(len(trajectory.time) - 1)
    segment_loads(
        trajectory.time, trajectory.position, trajectory.velocity, trajectory.acceleration, limits.rates, loads
    )
    column = -PROGRESS
    way, speed = trajectory.position[:, column] - trajectory.position[0, column], trajectory.velocity[:, column]
    lowered = cap.copy()
    for i in np.flatnonzero(loads > 1.0).tolist():
        reach = (window + _AROUND) * max(speed[i], speed[i + 1])
        near = (stations >= way[i] - reach) & (stations <= way[i + 1] + reach)
        lowered[near] = np.minimum(lowered[near], max(speed[i], speed[i + 1]) / (loads[i] * _FURTHER))
    return lowered


def _with_tool(limits: Limits, curve: ToolCurve, ramp_factor: float = 1.0) -> Limits:
    """The limits of the joints and of the columns of PROGRESS, with the jerk of the tool times `ramp_factor`."""
    turning = curve.rotational_speed / curve.speed
    free = 1e6  # the parameter itself is not limited
    speed = np.array((free, curve.speed, curve.rotational_speed))
    acceleration = np.array((free, curve.acceleration, curve.acceleration * turning))
    return replace(
        limits,
        velocity=np.append(limits.velocity, speed),
        acceleration=np.append(limits.acceleration, acceleration),
        jerk=np.append(limits.jerk, ramp_factor * acceleration / _RAMP),
    )


@dataclass(frozen=True)
class Progress:
    """How the tip advances along a curve: `state` has the columns of PROGRESS."""

    state: TimedTrajectory

    @classmethod
    def of(cls, trajectory: TimedTrajectory, dof: int) -> Progress:
        """That of a motion with PROGRESS more columns than joints."""
        return cls(trajectory.columns(slice(dof, None)))

    @cached_property
    def times(self) -> Array:
        """Times (n,) in s of the `samples`, at most some milliseconds apart."""
        return np.linspace(0.0, self.state.duration, max(200, int(self.state.duration / _STEP) + 2))

    @cached_property
    def samples(self) -> tuple[Array, Array]:
        """The state and its velocity (n, PROGRESS) at `times`."""
        position, velocity, _ = self.state.sample(self.times)
        return position, velocity

    def fraction(self, time: float) -> float:
        """The share of the curve behind the tip at a time (s)."""
        parameter = self.state.at(time)[0, 0]
        return float(np.clip(parameter / self.state.position[-1, 0], 0.0, 1.0))

    def message(self, curve: ToolCurve) -> ToolMotion:
        """How the tip moves, for a reply."""
        return ToolMotion(
            length=float(self.state.position[-1, 1]),
            speed=curve.speed,
            rotational_speed=curve.rotational_speed,
            speed_share=self._speed_share(curve),
        )

    def _speed_share(self, curve: ToolCurve) -> float:
        """The share (0..1) of the way on which the tip moves or turns as fast as it may."""
        position, velocity = self.samples
        full = (velocity[:, 1] >= _AT_SPEED * curve.speed) | (velocity[:, 2] >= _AT_SPEED * curve.rotational_speed)
        step = np.diff(position[:, 0])
        return float(np.clip(step[full[1:]].sum() / max(step.sum(), 1e-12), 0.0, 1.0))
