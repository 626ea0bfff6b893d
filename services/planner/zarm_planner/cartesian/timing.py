"""From joints at the stations of a curve to a motion with the tool speed that is asked for."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from zarm_contract.messages import ToolMotion
from zarm_planner.cartesian.curve import ToolCurve
from zarm_planner.timing.sampling import TOLERANCE, load, within
from zarm_planner.timing.time_parameterization import fastest_along, joined
from zarm_trajectory.limits import Limits
from zarm_trajectory.trajectory import TimedTrajectory

Array = NDArray[np.float64]

_SAMPLING = 0.01
"""Longest interval (s) between samples."""
_ROUNDS = 6
"""How often the joints' limits are lowered before the whole motion is slowed down."""
_TOOL_TOLERANCE = 2e-3
"""Share by which the tool may be too fast."""
_FURTHER = 1.001
"""Factor by which limits are lowered further than the load says."""
_RAMP = 0.1
"""s in which the tool's acceleration grows to its full value."""
_PARTS = 4
"""Parts of each interval between stations by which lengths are measured."""
_AT_SPEED = 0.99
"""Share of a speed that counts as it."""
PROGRESS = 3
"""Columns that a motion along a curve has besides the joints: the curve's parameter, the tip's way (m), its turn (rad)."""


def time_along(curve: ToolCurve, path: Array, limits: Limits, dt: float) -> TimedTrajectory | None:
    """The motion along the joints `path` (n, dof) at the curve's stations, at rest at both ends and where the curve
    rests; with PROGRESS more columns. None if TOPPRA fails numerically.

    Raises InvalidRequest if the limits make the motion longer than a message holds.
    """
    measured = _measured(curve)
    parts = []
    for first, last in curve.sections:
        stations = curve.stations[first : last + 1]
        rows = np.column_stack((path[first : last + 1], stations, measured[first : last + 1]))
        part = _timed(curve, stations, rows, limits, min(dt, _SAMPLING))
        if part is None:
            return None
        parts.append(part)
    return joined(parts)


def _measured(curve: ToolCurve) -> Array:
    """How far the tip has moved (m) and turned (rad) at each station: (n, 2)."""
    count = len(curve.stations)
    fine = np.interp(np.arange((count - 1) * _PARTS + 1) / _PARTS, np.arange(count), curve.stations)
    position, turned = curve.at(fine)
    moved = np.linalg.norm(np.diff(position, axis=0), axis=1)
    # The difference of two rotations that are an angle t apart has the Frobenius norm 2 sqrt(2) sin(t / 2).
    turns = 2.0 * np.arcsin(np.linalg.norm(np.diff(turned, axis=0), axis=(1, 2)) / 8.0**0.5)
    total = np.insert(np.cumsum(np.column_stack((moved, turns)), axis=0), 0, 0.0, axis=0)
    return np.asarray(total[::_PARTS])


def _timed(curve: ToolCurve, stations: Array, rows: Array, limits: Limits, dt: float) -> TimedTrajectory | None:
    spline = CubicSpline(stations, rows)
    along = TimedTrajectory(stations - stations[0], rows, spline(stations, 1), spline(stations, 2))
    lowered = eased = 1.0
    for number in itertools.count(1):
        profile = fastest_along(along, _with_tool(_slower(limits, lowered), curve, eased), dt)
        if profile is None:
            break
        trajectory = profile.sample(1.0, dt)
        joints, tool = _loads(trajectory, limits, curve)
        if joints <= 1.0 + TOLERANCE and tool <= 1.0 + _TOOL_TOLERANCE:
            return trajectory
        if number == _ROUNDS:
            return within(partial(profile.sample, dt=dt), _with_tool(limits, curve))
        lowered *= max(joints, 1.0) * _FURTHER if joints > 1.0 + TOLERANCE else 1.0
        eased *= max(tool, 1.0) * _FURTHER if tool > 1.0 + _TOOL_TOLERANCE else 1.0
    return None


def _loads(trajectory: TimedTrajectory, limits: Limits, curve: ToolCurve) -> tuple[float, float]:
    """How far the joints use their limits, and the tool its own, see `sampling.load`."""
    dof = len(limits.velocity)
    wide = _with_tool(limits, curve)
    tool = replace(limits, velocity=wide.velocity[dof:], acceleration=wide.acceleration[dof:], jerk=wide.jerk[dof:])
    return load(columns(trajectory, slice(dof)), limits), load(columns(trajectory, slice(dof, None)), tool)


def _slower(limits: Limits, factor: float) -> Limits:
    """The limits under which any motion takes `factor` times as long."""
    return replace(
        limits,
        velocity=limits.velocity / factor,
        acceleration=limits.acceleration / factor**2,
        jerk=limits.jerk / factor**3,
    )


def _with_tool(limits: Limits, curve: ToolCurve, eased: float = 1.0) -> Limits:
    """The limits of the joints and of the columns of PROGRESS; the tool's acceleration is `eased` like `_slower` does."""
    turning = curve.rotational_speed / curve.speed
    free = 1e6  # the parameter itself is not limited
    speed = np.array((free, curve.speed, curve.rotational_speed))
    acceleration = np.array((free, curve.acceleration, curve.acceleration * turning)) / eased**2
    return replace(
        limits,
        velocity=np.append(limits.velocity, speed),
        acceleration=np.append(limits.acceleration, acceleration),
        jerk=np.append(limits.jerk, acceleration / (eased * _RAMP)),
    )


@dataclass(frozen=True)
class Progress:
    """How the tip advances along a curve: `state` has the columns of PROGRESS."""

    state: TimedTrajectory

    @classmethod
    def of(cls, trajectory: TimedTrajectory, dof: int) -> Progress:
        """That of a motion with PROGRESS more columns than joints."""
        return cls(columns(trajectory, slice(dof, None)))

    def parameters(self, times: Array) -> Array:
        """The curve's parameter (n,) at times (n,) in s."""
        return np.asarray(self.state.sample(times)[0][:, 0])

    def fraction(self, time: float) -> float:
        """The share of the curve behind the tip at a time (s)."""
        parameter = self.parameters(np.array((time,)))[0]
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
        times = np.linspace(0.0, self.state.duration, max(200, int(self.state.duration / 0.002)))
        position, velocity, _ = self.state.sample(times)
        full = (velocity[:, 1] >= _AT_SPEED * curve.speed) | (velocity[:, 2] >= _AT_SPEED * curve.rotational_speed)
        step = np.diff(position[:, 0])
        return float(np.clip(step[full[1:]].sum() / max(step.sum(), 1e-12), 0.0, 1.0))


def columns(trajectory: TimedTrajectory, which: slice) -> TimedTrajectory:
    """The motion of some of the columns alone."""
    return TimedTrajectory(
        trajectory.time,
        np.ascontiguousarray(trajectory.position[:, which]),
        np.ascontiguousarray(trajectory.velocity[:, which]),
        np.ascontiguousarray(trajectory.acceleration[:, which]),
    )
