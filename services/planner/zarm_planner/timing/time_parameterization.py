"""From a path to a trajectory within the limits of velocity, acceleration and jerk.

Corners of the path are rounded by quintic curves that leave it by at most a stated distance; reachability analysis
(`kernels.reachability`) finds the fastest way along; a moving average over time turns its steps of acceleration into ramps
(Biagiotti and Melchiorri, "FIR filters for online trajectory planning with time- and frequency-domain specifications",
2012). If a limit is still exceeded between two samples, the whole motion is slowed down.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from zarm_contract.errors import InvalidRequest
from zarm_planner.kernels.reachability import fastest_squares
from zarm_planner.timing.averaging import Averaging, total_ways
from zarm_planner.timing.sampling import sample_times, within
from zarm_trajectory.arrays import Array
from zarm_trajectory.limits import Limits
from zarm_trajectory.trajectory import TimedTrajectory

_SAMPLING = 0.01
"""Longest interval (s) between samples. Steps of acceleration are averaged over at least two, which prolongs the motion."""
_MIN_AVERAGING_TIME = 2.0
"""Least averaging time, in samples: a quintic between two samples cannot follow a step."""
_STEP = 0.05
"""Length of path (rad) between points at which a velocity is chosen."""
_STEPS = 8
"""Least number of these on each straight piece and on each rounded corner."""
_STRETCHED = 1.005
"""How much longer the samples of an edge may take than the edge itself before others are tried,"""
_LONGER = (2.0, 4.0, 8.0, 16.0)
"""averaged over this many samples at least."""
_CURVE_STEP = 0.025
"""The same step (rad) on a curve through many points."""
_ROUNDING = 3 / 16
"""A corner rounded from `leg` before it to `leg` after it is left by `_ROUNDING * leg * |u_after - u_before|`."""


def time_path(path: Array, limits: Limits, dt: float, deviation: float) -> TimedTrajectory:
    """The fast motion from rest to rest along `path` (n, dof), sampled every `dt` s or less.

    Corners of the polyline `path` are rounded, leaving it by at most `deviation` (rad, Euclidean). With `deviation` 0,
    or if that is faster, the motion stops at every corner. Limits are held within 0.1 %.

    Raises InvalidRequest if the limits make the motion longer than `trajectory.MAX_SAMPLES`.
    """
    path, dt = _distinct(path), min(dt, _SAMPLING)
    if len(path) == 1:
        return TimedTrajectory.standing(path[0], dt)
    edges = [_straight(a, b, limits, dt, _MIN_AVERAGING_TIME) for a, b in itertools.pairwise(path)]
    if (
        len(edges) > 1
        and deviation > 0
        and (fastest := fastest_along(round_corners(path, deviation), limits, dt, _STEP, _STEPS))
    ):
        with suppress(InvalidRequest):  # rounding a tiny corner may take longer than stopping there
            trajectory = within(partial(fastest.sample, dt=dt), limits)
            if trajectory.duration < sum(edge.duration for edge in edges):
                return trajectory
    return joined(
        [_sampled(edge, a, b, limits, dt) for edge, (a, b) in zip(edges, itertools.pairwise(path), strict=True)]
    )


def _sampled(edge: Profile, a: Array, b: Array, limits: Limits, dt: float) -> TimedTrajectory:
    """The edge from `a` to `b`, sampled; an averaging time of a few samples is lengthened where that is faster.

    The quintics between samples change the acceleration faster than a ramp that begins and ends between them; held within
    the jerk limit, the whole motion would take longer by a tenth.
    """
    fastest = within(partial(edge.sample, dt=dt), limits)
    if fastest.duration > _STRETCHED * edge.duration:
        for samples in _LONGER:
            other = _straight(a, b, limits, dt, samples)
            if other.duration < fastest.duration:
                fastest = min(fastest, within(partial(other.sample, dt=dt), limits), key=lambda motion: motion.duration)
    return fastest


def _distinct(path: Array) -> Array:
    """The path (n, dof) without consecutive duplicates."""
    keep: NDArray[np.bool_] = np.insert(np.linalg.norm(np.diff(path, axis=0), axis=1) > 1e-9, 0, True)
    return path[keep]


def round_corners(path: Array, deviation: float) -> TimedTrajectory:
    """The polyline `path` with rounded corners, as the motion along it at about 1 rad/s: its time is the length (rad)."""
    edges = np.diff(path, axis=0)
    length = np.linalg.norm(edges, axis=1)
    along = edges / length[:, None]
    turn = np.linalg.norm(np.diff(along, axis=0), axis=1)
    leg = np.minimum(deviation / (_ROUNDING * np.maximum(turn, 1e-9)), 0.5 * np.minimum(length[:-1], length[1:]))
    before, after = path[1:-1] - leg[:, None] * along[:-1], path[1:-1] + leg[:, None] * along[1:]
    straight = length - np.append(leg, 0.0) - np.insert(leg, 0, 0.0)
    knots = np.concatenate([path[:1], np.stack([before, after], axis=1).reshape(-1, path.shape[1]), path[-1:]])
    tangents = np.repeat(along, 2, axis=0)
    steps = np.empty(2 * len(length) - 1)
    steps[0::2], steps[1::2] = straight, 2 * leg
    keep = np.insert(steps > 1e-9, 0, True)  # two roundings that meet leave no straight piece between them
    time = np.insert(np.cumsum(steps), 0, 0.0)
    return TimedTrajectory(time[keep], knots[keep], tangents[keep], np.zeros_like(knots[keep]))


def through(points: Array) -> TimedTrajectory:
    """The curve through `points` (n, dof) as the motion along it at about 1 rad/s: its time is the length (rad).

    A cubic spline: its slope and its curvature are continuous.
    """
    points = _distinct(points)
    length = np.insert(np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)), 0, 0.0)
    spline = CubicSpline(length, points)
    return TimedTrajectory(length, points, spline(length, 1), spline(length, 2))


def time_curve(curve: TimedTrajectory, limits: Limits, dt: float) -> TimedTrajectory | None:
    """The fast motion from rest to rest along `curve`, whose time is a length (rad), sampled every `dt` s or less.

    Limits are held within 0.1 %. None where they allow no motion.

    Raises InvalidRequest if the limits make the motion longer than `trajectory.MAX_SAMPLES`.
    """
    dt = min(dt, _SAMPLING)
    fastest = fastest_along(curve, limits, dt, _CURVE_STEP, 1)
    return None if fastest is None else within(partial(fastest.sample, dt=dt), limits)


@dataclass(frozen=True)
class Profile:
    """The motion along a curve: velocity `sd` (m,) at lengths `s` (m,), reached at times `t` (m,), with constant
    acceleration in between; all averaged over `window` s, which prolongs it by as much.
    """

    curve: TimedTrajectory
    s: Array
    sd: Array
    t: Array
    window: float

    @property
    def duration(self) -> float:
        """Its shortest duration (s)."""
        return float(self.t[-1]) + self.window

    def sample(self, factor: float, dt: float) -> TimedTrajectory:
        """The motion at `factor` times its shortest duration, sampled every `dt` s or slightly less."""
        t = sample_times(np.array([0.0, 0.5, 1.0]) * self.duration, factor, dt)
        area1, s1, sd1 = self._raw(t)
        area0, s0, sd0 = self._raw(t - self.window)
        s = np.clip((area1 - area0) / self.window, 0.0, self.s[-1])
        sd, sdd = ((s1 - s0) / self.window / factor)[:, None], ((sd1 - sd0) / self.window / factor**2)[:, None]
        sd[-1] = sdd[-1] = 0.0
        position, slope, bend = self.curve.sample(s)
        position[-1] = self.curve.position[-1]
        return TimedTrajectory(t * factor, position, slope * sd, bend * sd**2 + slope * sdd)

    def _raw(self, t: Array) -> tuple[Array, Array, Array]:
        """Before averaging: the integral over time of the length, the length and the velocity."""
        h = np.diff(self.t)
        sdd = np.diff(self.sd) / h
        area = np.insert(np.cumsum(h * (self.s[:-1] + h * (self.sd[:-1] / 2 + h * sdd / 6))), 0, 0.0)
        inside = np.clip(t, 0.0, self.t[-1])
        i = np.clip(np.searchsorted(self.t, inside, side="right") - 1, 0, len(h) - 1)
        x, s, sd, sdd = inside - self.t[i], self.s[i], self.sd[i], sdd[i]
        after_end = self.s[-1] * np.maximum(t - self.t[-1], 0.0)
        return area[i] + x * (s + x * (sd / 2 + x * sdd / 6)) + after_end, s + x * (sd + x * sdd / 2), sd + x * sdd


def _straight(a: Array, b: Array, limits: Limits, dt: float, shortest: float) -> Profile:
    """From `a` to `b`: accelerate, keep the speed if there is room for it, brake; averaged over `shortest` samples at least."""
    edge = np.abs(b - a)
    length = float(np.linalg.norm(edge))
    with np.errstate(divide="ignore", over="ignore"):
        rates = (limits.rates / edge).min(axis=1, keepdims=True) * length  # the slowest joint determines each
    used = Averaging.of(np.array((length,)), rates, shortest * dt)
    rate = float(used.acceleration[0])
    top = min(float(rates[0, 0]), math.sqrt(rate * length))
    ramp, keep = top * top / rate / 2, length - top * top / rate
    steps = np.array([ramp, keep, ramp] if keep > 1e-9 * length else [ramp, ramp])
    sd = np.array([0.0, *[top] * (len(steps) - 1), 0.0])
    t = np.cumsum(steps * 2 / (sd[1:] + sd[:-1]))
    curve = round_corners(np.stack([a, b]), 0.0)
    return Profile(curve, np.insert(np.cumsum(steps), 0, 0.0), sd, np.insert(t, 0, 0.0), used.window)


def fastest_along(
    curve: TimedTrajectory,
    limits: Limits,
    dt: float,
    step: float = math.inf,
    least: int = 1,
    cap: Array | None = None,
) -> Profile | None:
    """The fastest from rest to rest under the limits on velocity and acceleration, at points at most `step` (rad) apart, `least` on each
    piece of the curve; None where these allow no motion. `cap` bounds the velocity along the curve at each of these points.
    """
    pieces = np.maximum(least, np.ceil(np.diff(curve.time) / step)).astype(int)
    s = np.interp(np.arange(pieces.sum() + 1), np.insert(np.cumsum(pieces), 0, 0), curve.time)
    used = Averaging.of(total_ways(curve.position), limits.rates, _MIN_AVERAGING_TIME * dt)
    _, slope, bend = curve.states if len(s) == len(curve.time) else curve.sample(s)
    with np.errstate(divide="ignore"):
        most = (used.velocity / np.abs(slope)).min(axis=1) ** 2
    if cap is not None:
        most = np.minimum(most, cap**2)
    most[[0, -1]] = 0.0
    sd = np.sqrt(fastest_squares(s, _accelerations(s, slope, bend, used.acceleration), most, 0.0))
    if not np.all(np.isfinite(sd)) or np.any(sd[1:] + sd[:-1] <= 0.0):
        return None
    t = np.insert(np.cumsum(2 * np.diff(s) / (sd[1:] + sd[:-1])), 0, 0.0)
    return Profile(curve, s, sd, t, used.window)


def _accelerations(s: Array, slope: Array, bend: Array, acceleration: Array) -> Array:
    """What the joints' accelerations need, for `fastest_squares`, at lengths `s` (n,) and at the end of the interval that begins there."""
    dof, step = slope.shape[1], 2.0 * np.diff(s)[:, None]
    needs = np.empty((4, len(s), 2 * dof))
    needs[0, :, :dof], needs[1, :, :dof] = bend, slope
    needs[0, :-1, dof:], needs[1, :-1, dof:] = bend[1:], slope[1:] + step * bend[1:]
    needs[:2, -1, dof:] = 0.0
    needs[3] = np.tile(acceleration, 2)
    needs[2] = -needs[3]
    return needs


def joined(trajectories: Sequence[TimedTrajectory]) -> TimedTrajectory:
    """Motions in sequence, each beginning at rest where the previous one came to rest."""
    starts = np.cumsum([0.0, *(trajectory.duration for trajectory in trajectories[:-1])])
    first, *rest = trajectories
    return TimedTrajectory(
        np.concatenate([first.time, *(m.time[1:] + start for m, start in zip(rest, starts[1:], strict=True))]),
        *(
            np.concatenate([getattr(first, rows), *(getattr(m, rows)[1:] for m in rest)])
            for rows in ("position", "velocity", "acceleration")
        ),
    )
