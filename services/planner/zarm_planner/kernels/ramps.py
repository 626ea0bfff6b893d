"""Motions with bounded acceleration: a sequence of ramps. In each ramp every joint accelerates, keeps its velocity, and
accelerates by the opposite amount.

One joint from rest or motion to rest or motion in least time, or in a given time with least acceleration, in closed
form (Hauser and Ng-Thow-Hing, "Fast smoothing of manipulator trajectories using optimal bounded-acceleration
shortcuts", 2010).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.kernels.compiled import brief, inlined
from zarm_trajectory.arrays import Array

_SLACK = 1e-9
"""Tolerance for rounding of times (s), velocities and accelerations."""


class Ramps(NamedTuple):
    """Memory for ramps, of which a motion uses the first few. Joint j of ramp i has acceleration `acceleration[i, j]`
    for the first `first[i, j]` s, its negative for the last `last[i, j]` s, and zero in between.

    `via` (capacity,): whether the motion must always pass through the state at the start of the ramp. `duration`
    (capacity,) in s; `position` and `velocity` (capacity, dof) at the start of each ramp, in rad and rad/s;
    `acceleration` in rad/s^2, `first` and `last` in s, all (capacity, dof).
    """

    via: NDArray[np.bool_]
    duration: Array
    position: Array
    velocity: Array
    acceleration: Array
    first: Array
    last: Array


def make_ramps(capacity: int, dof: int) -> Ramps:
    """Allocate memory for `capacity` ramps."""
    return Ramps(np.empty(capacity, np.bool_), np.empty(capacity), *(np.empty((capacity, dof)) for _ in range(5)))


def ramps_from(ramps: Ramps, first: int) -> Ramps:
    """A view of all ramps from number `first` on."""
    return Ramps(
        ramps.via[first:],
        ramps.duration[first:],
        ramps.position[first:],
        ramps.velocity[first:],
        ramps.acceleration[first:],
        ramps.first[first:],
        ramps.last[first:],
    )


@inlined
def least_time(distance: float, start: float, end: float, fastest: float, strongest: float) -> float:
    """Least time (s) for one joint to move by `distance` from velocity `start` to `end`, within both limits.

    The joint accelerates to a peak velocity, perhaps keeps it for a while, and decelerates, or the mirror image of
    that.
    """
    best = np.inf
    for side in (1.0, -1.0):
        d, a, b = side * distance, side * start, side * end
        peak = strongest * d + 0.5 * (a * a + b * b)
        if peak < 0.0:
            continue
        peak = math.sqrt(peak)
        if peak < max(a, b) - _SLACK:
            continue
        if peak <= fastest:
            time = (2.0 * peak - a - b) / strongest
        else:
            ramps = (fastest * fastest - 0.5 * (a * a + b * b)) / strongest
            time = (2.0 * fastest - a - b) / strongest + (d - ramps) / fastest
        best = min(best, time)
    return best


@inlined
def in_time(
    distance: float, start: float, end: float, time: float, fastest: float, strongest: float
) -> tuple[bool, float, float, float]:
    """The ramp of one joint that moves by `distance` from velocity `start` to `end` in exactly `time` s, with least
    acceleration.

    Returns whether there is one within the limits, then acceleration, first and last as in `Ramps`. There is none if
    the joint would arrive too early without turning back and too late otherwise.
    """
    change = end - start
    lead = distance - 0.5 * (start + end) * time
    # Without a phase of constant velocity: a^2 T^2 - 4 lead a - change^2 = 0.
    root = math.sqrt(4.0 * lead * lead + time * time * change * change)
    found, acceleration, first, last = False, np.inf, 0.0, 0.0
    if root <= 1e-12:
        return abs(start) <= fastest + _SLACK, 0.0, 0.5 * time, 0.5 * time
    for side in (1.0, -1.0):
        a = (2.0 * lead + side * root) / (time * time)
        if a == 0.0:
            continue
        switch = 0.5 * (time + change / a)
        if switch < -_SLACK or switch > time + _SLACK:
            continue
        t1, t3 = max(switch, 0.0), max(time - switch, 0.0)
        peak = start + a * switch
        if abs(peak) > fastest + _SLACK:
            peak = math.copysign(fastest, peak)
            rest = distance - peak * time
            if rest == 0.0:
                continue
            bent = -0.5 * ((peak - start) ** 2 + (peak - end) ** 2) / rest
            if bent * a <= 0.0:
                continue
            a = bent
            t1, t3 = (peak - start) / a, (peak - end) / a
            if t1 < -_SLACK or t3 < -_SLACK or t1 + t3 > time + _SLACK:
                continue
            t1, t3 = max(t1, 0.0), max(t3, 0.0)
        if abs(a) <= strongest * (1.0 + 1e-7) and abs(a) < abs(acceleration):
            found, acceleration, first, last = True, a, t1, t3
    return found, acceleration, first, last


@inlined
def state(ramps: Ramps, i: int, t: float, position: Array, velocity: Array) -> None:
    """Write position and velocity (dof,) at `t` s into ramp `i`."""
    for j in range(position.shape[0]):
        first, last, a = ramps.first[i, j], ramps.last[i, j], ramps.acceleration[i, j]
        kept = max(ramps.duration[i] - first - last, 0.0)
        up, level, down = min(t, first), min(max(t - first, 0.0), kept), max(t - first - kept, 0.0)
        x = ramps.position[i, j] + ramps.velocity[i, j] * up + 0.5 * a * up * up
        v = ramps.velocity[i, j] + a * up
        position[j] = x + v * (level + down) - 0.5 * a * down * down
        velocity[j] = v - a * down


@inlined
def in_range(ramps: Ramps, i: int, lower: Array, upper: Array) -> bool:
    """Whether ramp `i` stays within the joints' ranges (dof,), including where joints reverse."""
    for j in range(lower.shape[0]):
        a, first, last = ramps.acceleration[i, j], ramps.first[i, j], ramps.last[i, j]
        x, v = ramps.position[i, j], ramps.velocity[i, j]
        least, most = x, x
        for phase in range(3):
            if phase == 1:
                x += v * max(ramps.duration[i] - first - last, 0.0)
            else:
                sign, h = (1.0, first) if phase == 0 else (-1.0, last)
                back = -v * sign / a if a != 0.0 else -1.0
                if 0.0 < back < h:
                    least, most = min(least, x + 0.5 * v * back), max(most, x + 0.5 * v * back)
                x += h * (v + 0.5 * sign * a * h)
                v += sign * a * h
            least, most = min(least, x), max(most, x)
        if least < lower[j] - _SLACK or most > upper[j] + _SLACK:
            return False
    return True


@inlined
def time_between(
    start: Array,
    start_velocity: Array,
    end: Array,
    end_velocity: Array,
    fastest: Array,
    strongest: Array,
    most: float,
    slow: NDArray[np.int64],
) -> float:
    """Least time (s) between two states for the joint that takes longest, or more than `most` s if it takes longer.

    `slow` (1,) is the joint that is tried first; it becomes one that took too long.
    """
    dof, first = start.shape[0], slow[0]
    time = 0.0
    for k in range(dof):
        j = first + k if first + k < dof else first + k - dof
        time = max(time, least_time(end[j] - start[j], start_velocity[j], end_velocity[j], fastest[j], strongest[j]))
        if time > most:
            slow[0] = j
            break
    return time


@inlined
def connect_states(
    ramps: Ramps,
    i: int,
    start: Array,
    start_velocity: Array,
    end: Array,
    end_velocity: Array,
    fastest: Array,
    strongest: Array,
    time: float,
) -> bool:
    """Make ramp `i` lead from one state to another in `time` s, in which all joints arrive together.

    Returns whether there is one; none is shorter than _SLACK.
    """
    ramps.duration[i] = time
    if not time > _SLACK:
        return False
    ramps.via[i] = False
    for j in range(start.shape[0]):
        found, a, first, last = in_time(
            end[j] - start[j], start_velocity[j], end_velocity[j], time, fastest[j], strongest[j]
        )
        if not found:
            return False
        ramps.position[i, j], ramps.velocity[i, j] = start[j], start_velocity[j]
        ramps.acceleration[i, j], ramps.first[i, j], ramps.last[i, j] = a, first, last
    return True


@brief
def along(path: Array, vias: NDArray[np.bool_], fastest: Array, strongest: Array, ramps: Ramps) -> int:
    """Write ramps straight along a path (n, dof), at rest at each of its corners; returns their number.

    `vias` (n,) says which rows are vias. Of repeated rows only one is kept.
    """
    count = 0
    via = False
    for i in range(path.shape[0] - 1):
        via = via or vias[i]
        speed, rate = np.inf, np.inf  # along the edge, as fractions of it: the slowest joint determines both
        for j in range(path.shape[1]):
            way = abs(path[i + 1, j] - path[i, j])
            if way > 1e-12:
                speed, rate = min(speed, fastest[j] / way), min(rate, strongest[j] / way)
        if speed == np.inf:
            continue
        time = least_time(1.0, 0.0, 0.0, speed, rate)
        _, a, first, last = in_time(1.0, 0.0, 0.0, time, speed, rate)
        ramps.via[count], ramps.duration[count] = via, time
        via = False
        for j in range(path.shape[1]):
            ramps.position[count, j], ramps.velocity[count, j] = path[i, j], 0.0
            ramps.acceleration[count, j] = a * (path[i + 1, j] - path[i, j])
            ramps.first[count, j], ramps.last[count, j] = first, last
        count += 1
    return count
