"""How long a robot on a trajectory needs to come to rest once an obstacle appears."""

from __future__ import annotations

from zarm_contract.descriptor import RobotDescriptor
from zarm_trajectory.follower import Follower
from zarm_trajectory.path_state import PathState
from zarm_trajectory.rate_bounds import RateLimits
from zarm_trajectory.trajectory import TimedTrajectory

_STEP = 0.05
"""Path time (s) between two evaluated points."""
_BRAKING_HORIZON = 0.3
"""Path time (s) ahead of the robot within which braking may begin."""
_BRAKING_STEP = 0.02
"""Time step (s) of the braking computation."""
_TIME_FACTOR = 1.1
"""Factor for an executor that brakes in ticks, and for a robot that comes to rest behind the command."""
_REACTION_TIME = 0.06
"""Longest time (s) for a pose to reach the servo, be checked, and have its result reach the executor."""
_TICKS = 3
"""Executor ticks until a stop takes effect."""


def reaction(descriptor: RobotDescriptor) -> float:
    """The time (s) from a pose until the robot begins to brake for it.

    If `execution.guard` is required, this also holds if the servo dies at that moment, which is noticed after
    `guard_timeout`.
    """
    execution, commands = descriptor.execution, descriptor.command_timing
    time = _REACTION_TIME + _TICKS * execution.control_period
    if commands is not None:
        time += commands.delay + commands.chunk_period + commands.look_ahead
    return time + (execution.guard_timeout if execution.guard == "required" else 0.0)


class StoppingTime:
    """Times to come to rest from full speed on one trajectory, inside `limits`, after a `reaction` time (s)."""

    def __init__(self, trajectory: TimedTrajectory, limits: RateLimits, reaction: float) -> None:
        self._follower, self._reaction = Follower(trajectory, limits), reaction
        self._known: dict[int, float] = {}

    def after(self, time: float) -> float:
        """Time (s) within which a robot at the path time `time` (s), or slightly further, comes to rest."""
        first, last = int(time / _STEP), int((time + _BRAKING_HORIZON) / _STEP) + 1
        return self._reaction + _TIME_FACTOR * max(self._braking(k) for k in range(first, last + 1))

    def _braking(self, k: int) -> float:
        if k not in self._known:
            trajectory = self._follower.trajectory
            time = min(max(k * _STEP, trajectory.begin), trajectory.duration)
            self._known[k], _ = self._follower.rest(PathState(time, 1.0), _BRAKING_STEP)
        return self._known[k]
