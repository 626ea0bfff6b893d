"""How long a robot on a trajectory needs to come to rest once an obstacle appears."""

from __future__ import annotations

from zarm_contract.robot import RobotDescriptor
from zarm_trajectory.follower import Follower
from zarm_trajectory.path_state import PathState
from zarm_trajectory.rate_bounds import RateLimits
from zarm_trajectory.trajectory import TimedTrajectory

_STEP = 0.05
"""Path time (s) from one point that is looked at to the next."""
_AHEAD = 0.3
"""So far (s of the path) ahead of the robot it may begin to brake."""
_POINT = 0.02
"""A braking is computed in steps of so much (s)."""
_SHARE = 1.1
"""An executor that brakes in ticks, and brings the robot to rest behind what it commands, takes longer by this factor."""
_WAY = 0.06
"""A pose is on its way to the servo, checked, and on its way to the executor for so long (s) at most."""
_TICKS = 3
"""Ticks of the executor until a stop takes effect."""


def reaction(descriptor: RobotDescriptor) -> float:
    """The time (s) from a pose until the robot begins to brake for it.

    Where `execution.guard` is required it holds also when the servo dies at that moment, and is missed after `guard_timeout`.
    """
    execution, driver = descriptor.execution, descriptor.strategy_params
    time = _WAY + _TICKS * execution.control_period
    if driver is not None:
        time += driver.delay + driver.chunk_period + driver.look_ahead
    return time + (execution.guard_timeout if execution.guard == "required" else 0.0)


class StoppingTime:
    """Times to rest from the full speed of one trajectory, inside `limits`, with a `reaction` (s) before."""

    def __init__(self, trajectory: TimedTrajectory, limits: RateLimits, reaction: float) -> None:
        self._follower, self._reaction = Follower(trajectory, limits), reaction
        self._known: dict[int, float] = {}

    def after(self, time: float) -> float:
        """Within so long (s) a robot rests that is at the path time `time` (s), or a little further."""
        first, last = int(time / _STEP), int((time + _AHEAD) / _STEP) + 1
        return self._reaction + _SHARE * max(self._braking(k) for k in range(first, last + 1))

    def _braking(self, k: int) -> float:
        if k not in self._known:
            trajectory = self._follower.trajectory
            time = min(max(k * _STEP, trajectory.begin), trajectory.duration)
            self._known[k] = _POINT * self._follower.moved_to(PathState(time, 1.0), 0.0).ahead(_POINT).last
        return self._known[k]
