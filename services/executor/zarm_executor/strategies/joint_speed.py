"""The strategy that streams velocities and closes the loop with the measured joints.

velocity = planned + gain * (planned position - measured position), then clamped. The robot integrates velocities, so the error e obeys
de/dt = -gain * e: it decays at that rate instead of adding up, slowly enough for the loop's dead time (`strategy_params.gain` has the bound).

The planned position is the nearest one of those commanded shortly before the joints were measured. So a driver that reacts sooner or later than its
`delay` makes the robot early or late on its path, and does not draw it off the path. At the end of the path it is the end.
"""

from __future__ import annotations

import numpy as np

from zarm_executor.strategies.driver_link import DriverLink
from zarm_executor.strategies.streaming import Streaming
from zarm_trajectory.arrays import Array
from zarm_trajectory.retimed import RetimedTrajectory
from zarm_trajectory.trajectory import TimedTrajectory

_MIN_WINDOW = 0.12
"""The planned position is one commanded within this time (s), or within twice the `delay`, before the joints were measured."""
ARRIVED = 0.002
"""At the end of a path, the robot is corrected until every joint is this close to it (rad); 0.005 is promised."""


class JointSpeed(Streaming):
    """Sends chunks of velocities that change no faster than `strategy_params.acceleration`."""

    name = "joint_speed"
    link: DriverLink

    def __init__(self, link: DriverLink) -> None:
        super().__init__(link)
        self._sent: Array = np.zeros((0, len(link.joints)))
        self._before: Array = np.zeros(len(link.joints))
        self._leading_since: float | None = None
        self._back_on_path = False

    def start(self, trajectory: TimedTrajectory, speed: float) -> None:
        """Begin at the start of `trajectory`, from rest."""
        super().start(trajectory, speed)
        self._stands()

    def steer(self, trajectory: TimedTrajectory) -> None:
        """Continue along `trajectory`, whose end the robot has yet to reach."""
        super().steer(trajectory)
        self._leading_since, self._back_on_path = None, False

    def _send(self, ahead: RetimedTrajectory, now: float, played: int) -> bool:
        base = self._playing(played)
        velocity = self._clamped(ahead.points.velocity + self._correction(ahead, now), base)
        acceleration = np.diff(velocity, axis=0, prepend=base[None]) / self._dt
        self.link.send(TimedTrajectory(ahead.points.time, ahead.points.position, velocity, acceleration))
        self._before, self._sent = base, velocity
        return not velocity.any()

    def _forget_sent(self) -> None:
        self._sent = self._sent[:0]

    def _stands(self) -> None:
        self._sent, self._before = self._sent[:0], np.zeros_like(self._before)
        self._leading_since, self._back_on_path = None, False

    def _playing(self, played: int) -> Array:
        """The velocity (J,) that the driver plays now; without points left, the driver is braking or has stopped the
        robot.
        """
        if played == 0:
            return self._before
        if played <= len(self._sent):
            velocity: Array = self._sent[played - 1]
            return velocity
        return self.link.velocity()

    def _correction(self, ahead: RetimedTrajectory, now: float) -> Array:
        """The correction added to the velocities (N, J); it decays over the chunk as the error does."""
        error = self._error(now)
        self._lead(now, error)
        if error is None or self._back_on_path or self._held():
            return np.zeros_like(ahead.points.velocity)
        gain = self.link.params.gain
        share = gain * (1.0 - gain * self._dt) ** np.arange(len(ahead))
        return np.outer(share, error)

    def _held(self) -> bool:
        """Whether the robot was stopped; a push must not make it move."""
        follower = self._follower
        return follower is None or (follower.target == 0.0 and follower.settled)

    def _error(self, now: float) -> Array | None:
        """Planned minus measured position (J,); None if the joints are too old or too far off for a correction."""
        measured, execution = self.link.measured(), self.link.execution
        if measured is None or now - measured.time > execution.joint_state_timeout:
            return None
        if (follower := self._follower) is not None and follower.finished and self._caught_up():
            planned = follower.position
        else:
            window = max(2.0 * self._delay, _MIN_WINDOW)
            planned = self._reference.nearest(measured.position, measured.time - window, measured.time)
        error: Array = planned - measured.position
        return error if np.all(np.abs(error) <= execution.path_tolerance) else None

    def _lead(self, now: float, error: Array | None) -> None:
        """At the end of the path: note when the robot has arrived, or has failed to within `settle_time`."""
        follower, measured, execution = self._follower, self.link.measured(), self.link.execution
        if follower is None or not follower.finished or not self._caught_up():
            return
        if self._leading_since is None:
            self._leading_since = now
        near = error is not None and bool(np.all(np.abs(error) <= ARRIVED))
        rests = measured is not None and bool(np.all(np.abs(measured.velocity) <= execution.stopped_velocity))
        self._back_on_path = self._back_on_path or (near and rests) or now - self._leading_since > execution.settle_time

    def _arrived(self) -> bool:
        return self._back_on_path

    def _clamped(self, wanted: Array, base: Array) -> Array:
        """The velocities (N, J) closest to those wanted that the bounds allow for a robot coming from `base` (J,)."""
        most, step = self.link.velocity_clamp, self.link.acceleration_clamp * self._dt
        velocity = np.clip(wanted, -most, most)
        for row in velocity:
            np.clip(row, base - step, base + step, out=row)
            base = row
        return velocity
