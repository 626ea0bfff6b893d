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
    fine = np.unique(
        np.concatenate([np.linspace(a, b, _PARTS + 1) for a, b in itertools.pairwise(curve.stations.tolist())])
    )
    position, turned = curve.at(fine)
    moved = np.linalg.norm(np.diff(position, axis=0), axis=1)
    turns = (turned[:-1].inv() * turned[1:]).magnitude()
    total = np.insert(np.cumsum(np.column_stack((moved, turns)), axis=0), 0, 0.0, axis=0)
    return np.asarray(total[np.searchsorted(fine, curve.stations)])


def _timed(curve: ToolCurve, stations: Array, rows: Array, limits: Limits, dt: float) -> TimedTrajectory | None:
    spline = CubicSpline(stations, rows)
    along = TimedTrajectory(stations - stations[0], rows, spline(stations, 1), spline(stations, 2))
    wide = _with_tool(limits, curve)
    lowered, profile = 1.0, fastest_along(along, wide, dt)
    for _ in range(_ROUNDS):
        if profile is None:
            return None
        trajectory = profile.sample(1.0, dt)
        used = load(trajectory, wide)
        if used <= 1.0 + TOLERANCE:
            return trajectory
        lowered *= used * 1.001
        profile = fastest_along(along, _with_tool(_slower(limits, lowered), curve), dt)
    if profile is None:
        return None
    return within(partial(profile.sample, dt=dt), wide)


def _slower(limits: Limits, factor: float) -> Limits:
    """The limits under which any motion takes `factor` times as long."""
    return replace(
        limits,
        velocity=limits.velocity / factor,
        acceleration=limits.acceleration / factor**2,
        jerk=limits.jerk / factor**3,
    )


def _with_tool(limits: Limits, curve: ToolCurve) -> Limits:
    """The limits of the joints and of the columns of PROGRESS."""
    turning = curve.rotational_speed / curve.speed
    free = 1e6  # the parameter itself is not limited
    speed = np.array((free, curve.speed, curve.rotational_speed))
    acceleration = np.array((free, curve.acceleration, curve.acceleration * turning))
    return replace(
        limits,
        velocity=np.append(limits.velocity, speed),
        acceleration=np.append(limits.acceleration, acceleration),
        jerk=np.append(limits.jerk, acceleration / _RAMP),
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
