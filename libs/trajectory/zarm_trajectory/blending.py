"""Blends from the present motion of a robot to another one, without a jump.

At one moment the robot leaves the old trajectory on a quintic that meets the new one in position, velocity and
acceleration a blending time later. From a list of blending times the shortest is used whose quintic is inside every
limit, including jerk. If there is none, as for a new trajectory that brakes at the limits itself and arrives slightly
late, the robot comes to rest on the old trajectory and continues to the end of the new one. If the new trajectory
continues the old one, no blending is needed, and it is followed exactly. If it is off by so little that a correction needs
less than the tolerance of the limits, it is followed at once, and the offset fades away: a robot that measures its joints is a
little off what it was told. The path speed is unchanged, so what the
follower guarantees for a trajectory inside the limits also holds during the blend.
"""

from __future__ import annotations

import numpy as np

from zarm_contract.errors import ExecutionRefused, InvalidRequest
from zarm_trajectory.arrays import Array
from zarm_trajectory.limits import LIMIT_TOLERANCE, Limits
from zarm_trajectory.quintic import coefficients, control_points, derivative, states
from zarm_trajectory.trajectory import TimedTrajectory

BLENDS = np.array([0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.7, 1.0])
"""Blending times to try, s of path time."""
PAST = 2.0
"""How much (s) of a trajectory's past is kept: more than any strategy looks back for a robot that lags."""
LONGEST_REST = 10.0
"""How long (s) a robot may wait at the end of its trajectory for the start of a chunk."""
_MIN_INTERVAL = 1e-4
"""Least time (s) between samples of a blended trajectory."""
_CONTINUED = 1e-6
"""A trajectory continues another if position (rad), velocity and acceleration differ by no more than this, due to
rounding.
"""
_CLOSE = 1e-5
"""Least time (s) between samples where a trajectory continues another."""
_SMALL = LIMIT_TOLERANCE - 1.002
"""Share of the limits that an offset may need to fade away: nearly all that they tolerate."""


def blended(
    trajectory: TimedTrajectory, now: float, chunk: TimedTrajectory, start: float, limits: Limits
) -> TimedTrajectory:
    """`trajectory` until the path time `now` (s), or until `start` if that is later, then over to `chunk`.

    `chunk` has its own time 0 at the path time `start`; if `now` is later, its beginning is skipped. Both rest at their
    ends for as long as necessary.

    Raises ExecutionRefused (`limit_violated`) if no blending time is inside the limits, and `trajectory` does not come
    to rest shortly before and close to the end of `chunk` either; and InvalidRequest if `chunk` starts later than
    `LONGEST_REST` after the end of `trajectory`.
    """
    if start > trajectory.duration + LONGEST_REST:
        raise InvalidRequest(
            f"the chunk starts at {start:.2f} s of a stream that ends at {trajectory.duration:.2f} s so far; let it start at most "
            f"{LONGEST_REST:g} s after that",
            field="start",
        )
    begin = max(now, start)
    here = _state(trajectory, begin), _state(chunk, begin - start)
    if begin - start < chunk.duration - _CLOSE and _continues(*here):
        return _followed_by(trajectory, now, begin, here[1][:, None], chunk.begun_at(start), begin, _CLOSE)
    faded = _faded(chunk.begun_at(start), begin, here[0] - here[1], limits)
    if faded is not None:
        return _followed_by(trajectory, now, begin, here[0][:, None], faded, begin, _CLOSE)
    joins = begin + BLENDS
    before = _states(trajectory, np.full_like(joins, begin))
    after = _states(chunk, joins - start)
    with np.errstate(all="ignore"):
        first = limits.first_inside(coefficients(before, after, BLENDS), BLENDS)
    if first is None:
        by_rest = _by_rest(trajectory, now, begin, chunk.begun_at(start), limits)
        if by_rest is not None:
            return by_rest
        off = float(np.abs(here[1][0] - here[0][0]).max())
        raise ExecutionRefused(
            f"the chunk is {off:.4f} rad from the motion that it must continue, at {begin:.2f} s of the stream, and cannot "
            f"be reached within {BLENDS[-1]:g} s inside the limits; send a chunk that continues from where the robot is then",
            code="limit_violated",
        )
    between = np.concatenate((before[:, :1], after[:, first : first + 1]), axis=1)
    return _followed_by(trajectory, now, begin, between, chunk.begun_at(start), float(joins[first]), _MIN_INTERVAL)


def continued(trajectory: TimedTrajectory, now: float, other: TimedTrajectory, start: float) -> TimedTrajectory:
    """`trajectory` until the path time `start` (s), and from there `other`, which begins exactly in the state of
    `trajectory`.

    `now` is the commanded path time (s). Raises ExecutionRefused (`start_state_mismatch`) if position, velocity or
    acceleration would jump.
    """
    here = _state(trajectory, start), _state(other, 0.0)
    if not _continues(*here):
        off = np.abs(here[1] - here[0]).max(axis=1)
        raise ExecutionRefused(
            f"the trajectory does not begin where the one before is at {start:.3f} s: it is off by {off[0]:.2g} rad, "
            f"{off[1]:.2g} rad/s and {off[2]:.2g} rad/s^2; plan from the state of the trajectory at that time",
            code="start_state_mismatch",
        )
    return _followed_by(trajectory, now, start, here[1][:, None], other.begun_at(start), start, _CLOSE)


def _faded(chunk: TimedTrajectory, begin: float, offset: Array, limits: Limits) -> TimedTrajectory | None:
    """`chunk` with an offset (3, J) at `begin` (s) that fades away; None if that needs more than _SMALL, or longer than the chunk,
    or if both together are outside the limits.
    """
    offsets = np.repeat(offset[:, None], len(BLENDS), axis=1)
    curve = fading = coefficients(offsets, np.zeros_like(offsets), BLENDS)
    inside = begin + BLENDS < chunk.duration - _MIN_INTERVAL
    for limit in (limits.velocity, limits.acceleration, limits.jerk):
        curve = derivative(curve) / BLENDS[:, None]
        inside &= (np.abs(control_points(curve)).max(axis=0) <= _SMALL * limit).all(axis=1)
    if not inside.any():
        return None
    first = int(inside.argmax())
    took = float(BLENDS[first])
    later = chunk.time[np.abs(chunk.time - begin - took) > _MIN_INTERVAL]
    times = np.sort(np.append(later[later > begin + _CLOSE], begin + took))
    rows = chunk.sample(times)
    fades = times < begin + took
    off = states(fading[:, first, None], ((times[fades] - begin) / took)[:, None])
    for power, each in enumerate(off):
        rows[power, fades] += each / took**power
    until = int(fades.sum()) + 1
    try:
        limits.check(TimedTrajectory(times[:until], *rows[:, :until]))
    except ExecutionRefused:
        return None
    return TimedTrajectory(times, *rows)


def _by_rest(
    trajectory: TimedTrajectory, now: float, begin: float, chunk: TimedTrajectory, limits: Limits
) -> TimedTrajectory | None:
    """`trajectory` until it first comes to rest from `begin` (s) on, and from there straight to the end of `chunk`.

    None if that rest is later than that of `chunk`, or more than the longest blending time before it, or too far from
    it to be bridged in that time.
    """
    rest, end = _rests(trajectory, begin), _moves_until(chunk)
    way = TimedTrajectory.standing(chunk.end, chunk.duration - chunk.begin).approached_from(
        trajectory.at(rest)[0], limits.velocity, limits.acceleration, limits.jerk
    )
    longest = float(BLENDS[-1])
    if not (rest - _CLOSE <= end <= rest + longest and way.time[-2] <= longest):
        return None
    return _followed_by(trajectory, now, rest, way.states[:, :1], way.begun_at(rest), rest, _CLOSE)


def _rests(trajectory: TimedTrajectory, begin: float) -> float:
    """The first time (s) from `begin` on at which a trajectory is at rest."""
    times = np.append(begin, trajectory.time[trajectory.time > begin])
    return float(times[np.flatnonzero((_states(trajectory, times)[1:] == 0.0).all(axis=(0, 2)))[0]])


def _moves_until(trajectory: TimedTrajectory) -> float:
    """The time (s) from which a trajectory stays at rest."""
    moving = np.flatnonzero(_states(trajectory, trajectory.time)[1:].any(axis=(0, 2)))
    return float(trajectory.time[moving[-1] + 1]) if moving.size else trajectory.begin


def _continues(before: Array, after: Array) -> bool:
    return bool(np.abs(after - before).max() <= _CONTINUED)


def _followed_by(
    old: TimedTrajectory, now: float, begin: float, between: Array, new: TimedTrajectory, join: float, apart: float
) -> TimedTrajectory:
    """`old` up to `begin` (s), then `between` (3, N, J), states at `begin` and, if there are two, at `join`, then
    `new`.
    """
    kept, coming = (old.time >= old.since(now - PAST).time[0]) & (old.time < begin - apart), new.time > join + apart
    times, states = [old.time[kept]], [old.states[:, kept]]
    if old.duration + apart < begin - apart:  # it rests until then
        times.append(np.array([old.duration + apart]))
        states.append(_states(old, times[-1]))
    times += [np.array([begin, join][: between.shape[1]]), new.time[coming]]
    states += [between, new.states[:, coming]]
    return TimedTrajectory(np.concatenate(times), *np.concatenate(states, axis=1))


def _state(trajectory: TimedTrajectory, time: float) -> Array:
    """Position, velocity and acceleration (3, J); at its end and later a trajectory is at rest."""
    state = trajectory.at(time)
    if time >= trajectory.duration:
        state[1:] = 0.0
    return state


def _states(trajectory: TimedTrajectory, times: Array) -> Array:
    """The same (3, N, J) at N times (N,)."""
    states = trajectory.sample(times.clip(trajectory.time[0], trajectory.duration))
    states[1:, times >= trajectory.duration] = 0.0
    return states
