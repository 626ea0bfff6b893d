"""What a strategy needs to know of a robot that it moves: its limits, and where it is."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from zarm_contract.descriptor import CommandTiming, RobotDescriptor
from zarm_executor.strategies.base import Measured
from zarm_runtime import clock
from zarm_trajectory.arrays import Array
from zarm_trajectory.rate_bounds import RateLimits

_REST_MOTION = 5e-4
_REST_TIME = 0.1
"""A robot stands if it has not moved by more than the first (rad) for the second (s): 0.005 rad/s."""


_CLOCK_TOLERANCE = 1.0
"""Largest difference (s, real time) between the stamp of joint states and the time of their arrival, in a simulation that is faster than real time."""


def on_another_clock(stamp: float, at: float) -> bool:
    """Whether joint states with this stamp (Unix s) that arrived `at` (s, monotonic) are of a robot that runs slower than this process, so that it must
    not be moved: a real one is, and its stamps are far in the past of a faster clock.
    """
    return clock.speed != 1.0 and abs(stamp - clock.unix_time_of(at)) > _CLOCK_TOLERANCE * clock.speed


def runs_slower(who: str) -> str:
    """Why `who`, whose joint states are `on_another_clock`, is not moved."""
    return f"{who} runs in real time, and this executor faster (ZARM_SIM_SPEED): it moves only a simulated robot that runs as fast"


class RobotLink(ABC):
    """The robot of a descriptor, which commands reach with this `timing`. `joints` are in the executor's order."""

    def __init__(self, descriptor: RobotDescriptor, timing: CommandTiming) -> None:
        self.timing = timing
        self.execution = descriptor.execution
        self.joints = descriptor.joints
        self.limits = RateLimits.of(descriptor)
        self.velocity_clamp = np.array(descriptor.cspace.velocity)
        self.acceleration_clamp = np.array(descriptor.cspace.acceleration)
        self._stood: Measured | None = None

    @abstractmethod
    def begin(self) -> None:
        """A motion begins from rest."""

    @abstractmethod
    def stop(self) -> int:
        """Make the robot stop now, by its own means; returns the command's number."""

    @abstractmethod
    def measured(self) -> Measured | None:
        """The newest readable joints, in the executor's order; None before the first."""

    @abstractmethod
    def pace(self) -> float:
        """The share (0..1) of the commanded speed that the robot's own controls allow."""

    @abstractmethod
    def obstacle(self) -> str | None:
        """Why the robot cannot be moved now; None if it can."""

    def is_reporting(self, now: float) -> bool:
        """Whether the robot is heard: its newest joints are fresh at `now`, on the monotonic clock.

        Otherwise it is sent only stops: anything else might be held up as long, and played then.
        """
        measured = self.measured()
        return measured is not None and now - measured.time <= self.execution.joint_state_timeout

    def velocity(self) -> Array:
        """The measured velocities (J,), clamped to those that may be sent.

        Zero if they are old: a motion from before a silence must not start again after it.
        """
        measured = self.measured()
        old = measured is None or clock.monotonic() - measured.time > self.execution.joint_state_timeout
        reported = np.zeros_like(self.velocity_clamp) if measured is None or old else measured.velocity
        return np.clip(reported, -self.velocity_clamp, self.velocity_clamp)

    def standing(self) -> bool:
        """Whether the robot stands, judged by its velocities and, because some drivers report none, by its positions."""
        measured = self.measured()
        if measured is None or self._stood is None or measured.time - self._stood.time < _REST_TIME:
            return False
        return bool(np.all(np.abs(measured.velocity) <= self.execution.stopped_velocity))

    def _note(self, measured: Measured) -> None:
        """New joints, from which it is seen whether the robot stands."""
        if self._stood is None or np.any(np.abs(measured.position - self._stood.position) > _REST_MOTION):
            self._stood = measured
