"""The interface of every control strategy."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

from zarm_trajectory.arrays import Array
from zarm_trajectory.path_state import PathState
from zarm_trajectory.trajectory import TimedTrajectory


@dataclass(frozen=True, slots=True)
class Measured:
    """Joint positions (J,) rad and velocities (J,) rad/s, measured at `time` on the monotonic clock.

    `effort` (J,) in Nm is None where it is not measured. `stamp` is the time of day (Unix s) by the driver's own clock; None if the joints did not come from a driver.
    """

    position: Array
    velocity: Array
    time: float
    stamp: float | None = None
    effort: Array | None = None


@dataclass(frozen=True, slots=True)
class Progress:
    """Progress of a motion: path time `time` (s), path speed `speed` in [0, 1], commanded positions `command` (J,)."""

    time: float
    speed: float
    command: Array
    finished: bool

    @property
    def at_rest(self) -> bool:
        """Whether the commanded robot stands still."""
        return self.finished or self.speed == 0.0


class Strategy(ABC):
    """One way to move one robot along a trajectory.

    The state machine owns it and calls one method at a time, so a strategy needs no lock; each call must return within
    a fraction of a tick. Motions never overlap: after `start`, no other comes until the first is at rest.
    """

    name: ClassVar[str]

    def obstacle(self) -> str | None:
        """Why this strategy cannot be opened now, in a sentence with the remedy; None if it can."""
        return None

    def problem(self) -> str | None:
        """Why the driver plays no further what it was sent, in its words; None if it has not said so."""
        return None

    def pace(self) -> float:
        """The share (0..1) of the commanded speed that the robot's own controls allow."""
        return 1.0

    @abstractmethod
    def open(self) -> None:
        """Take control of the robot. Raises a ZarmError if that fails; nothing is held then."""

    @abstractmethod
    def close(self) -> None:
        """Release the robot, which is at rest. It may be opened again."""

    @abstractmethod
    def admit(self) -> None:
        """Raise Unavailable, with the remedy, if this strategy cannot move the robot now."""

    @abstractmethod
    def start(self, trajectory: TimedTrajectory, speed: float) -> None:
        """Start to move along `trajectory` from the robot's position, at this path speed in (0, 1].

        Its first sample may be later than 0 s: path time continues if a goal gets another trajectory at rest.
        """

    @abstractmethod
    def stop(self) -> None:
        """Decelerate to rest along the path, inside the limits of acceleration and jerk. Idempotent."""

    @abstractmethod
    def move(self, speed: float) -> None:
        """Continue along the same path at this path speed in (0, 1]: after `stop`, or in motion to change the speed.

        The path speed changes to it inside the limits of acceleration and jerk.
        """

    def end(self) -> None:  # noqa: B027 - most strategies have nothing to do
        """The motion has ended, and nothing goes on from here: the goal is over."""

    @abstractmethod
    def tick(self, now: float, dt: float) -> None:
        """One period of the control loop: `now` on the monotonic clock, `dt` s since the last one.

        If the joint states are older than `joint_state_timeout`, the robot is brought to rest. When they return, the
        motion continues from there, unless it was told to stop.
        """

    @abstractmethod
    def joint_state(self) -> Measured | None:
        """The newest measured state of the robot, also while nothing moves; None before the first."""

    @abstractmethod
    def braking_from(self) -> PathState:
        """The path state from which the robot would brake if `stop` were called now."""

    @abstractmethod
    def progress(self) -> Progress:
        """Progress of the motion begun by the last `start`."""


class Steerable(Strategy):
    """A strategy whose trajectory may change while it is followed."""

    @abstractmethod
    def commanded(self) -> float:
        """The path time (s) that is being commanded."""

    @abstractmethod
    def steer(self, trajectory: TimedTrajectory) -> None:
        """Continue along `trajectory`, which meets the present one at the commanded path time."""
