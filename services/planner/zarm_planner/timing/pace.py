"""Slows a motion down only where it needs more torque than its joints have.

The motion goes through its own time at a pace of at most 1, which is the fastest that torque and acceleration allow
(`kernels.reachability`: for the time s of the motion as a function of time, a quantity that is linear in position, velocity
and acceleration is a factor times ds² and another times dds), averaged over a short time, so that the jerk is bounded. Where the average exceeds a limit, which it does
where the motion itself changes abruptly, less is allowed there, and again.
"""

from __future__ import annotations

import numpy as np

from zarm_planner.kernels.pace import averaged_pace, tightened, times_at_pace
from zarm_planner.kernels.reachability import fastest_squares
from zarm_planner.timing.sampling import sample_times
from zarm_trajectory.arrays import Array
from zarm_trajectory.limits import Limits
from zarm_trajectory.trajectory import TimedTrajectory

_WINDOW = 8.0
"""The averaging time, in the times in which the joints reach their largest acceleration."""
_MIN_SQUARED_PACE = 1e-4
"""Least square of a pace: a hundredth of the motion's own."""
_ROUNDS = 4
"""How often less is allowed where a limit is exceeded."""
_LITTLE = 1.002
"""How far limits may be exceeded without another round."""


def paced(motion: TimedTrajectory, grid: Array, states: Array, torque: Array, limits: Limits) -> TimedTrajectory:
    """The motion along the same path, nowhere faster, in which the first joints keep about to their torques.

    At the times `grid` (n,) it has `states` (3, n, columns). `torque` (4, n, dof) has, without what holds the robot, the torque
    of the motion there, that of an acceleration as large as its velocity, and the bounds of both. Columns beyond the
    joints of `limits` accelerate no more than they did.

    Raises InvalidRequest if it becomes longer than a message holds.
    """
    _, velocity, acceleration = states
    changes = np.stack((velocity, acceleration, motion.jerks(grid)))
    joints = slice(len(limits.joints))
    rates = np.abs(changes[1:]).max(axis=1)
    rates[:, joints] = np.maximum(rates[:, joints], limits.rates[1:])
    strongest = np.broadcast_to(rates[0], acceleration.shape)
    accelerating = np.stack((acceleration, velocity, -strongest, strongest))
    share, most = np.ones(len(grid)), np.ones(len(grid))
    window = _WINDOW * float((limits.acceleration / limits.jerk).max())
    reach = window / 2.0 + float(np.diff(grid).max())
    for _ in range(_ROUNDS):
        bounded = torque.copy()
        bounded[2:] *= share[:, None]
        square = fastest_squares(grid, np.concatenate((bounded, accelerating), axis=2), most, _MIN_SQUARED_PACE)
        at = times_at_pace(grid, square)
        pace = averaged_pace(grid, square, at, window, at)
        if tightened(at, pace, torque, changes, rates, reach, share, most) <= _LITTLE:
            break
    times = sample_times(np.interp(motion.time, grid, at), 1.0, float(motion.steps.max()))
    here, pace, rate, _ = averaged_pace(grid, square, at, window, times)
    here[[0, -1]] = 0.0, motion.duration
    position, velocity, acceleration = motion.sample(here.clip(0.0, motion.duration))
    velocity, acceleration = velocity * pace[:, None], acceleration * pace[:, None] ** 2 + velocity * rate[:, None]
    position[-1], velocity[-1], acceleration[-1] = motion.states[:, -1]
    return TimedTrajectory(times, position, velocity, acceleration)
