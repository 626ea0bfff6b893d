"""Conditions that must hold while a robot moves, and until it is at rest in the right place."""

from __future__ import annotations

import numpy as np

from zarm_contract.descriptor import RobotDescriptor
from zarm_contract.errors import ExecutionFailed, Problem
from zarm_executor.strategies.base import Measured, Progress
from zarm_trajectory.arrays import Array
from zarm_trajectory.follower import CATCH_UP
from zarm_trajectory.trajectory import TimedTrajectory

SLOWEST_PACE = 0.05
"""Slowest pace relative to the command that a driver may have, as a UR with its speed slider down: that of the slowest
speed scale.
"""

BRAKING = 1.5
"""Bound on braking along a path, as a multiple of what the worst joint alone needs from its velocity limit to rest, by
its limits of acceleration and jerk. Measured over random paths at every limit: 1.2.
"""


class NotStopped(ExecutionFailed):
    """The robot did not stop when told to, or not where it should have."""


class Monitor:
    """Watches one motion. Times are on the monotonic clock; joints in the descriptor's order."""

    def __init__(self, trajectory: TimedTrajectory, robot: RobotDescriptor) -> None:
        self._trajectory = trajectory
        self._joints = robot.joints
        self._execution = robot.execution
        self.faults = robot.execution.faults
        delay = 0.0 if robot.command_timing is None else robot.command_timing.delay
        limits = robot.cspace
        alone = max(v / a + a / j for v, a, j in zip(limits.velocity, limits.acceleration, limits.jerk, strict=True))
        self._stopping = BRAKING * alone + delay + robot.execution.settle_time
        self._stopping_since: float | None = None
        self._commanded = 0.0
        self._rest_since: float | None = None
        self._reached = 0.0
        self._reached_at: float | None = None
        self._received_at: float | None = None
        self._paused_for = 0.0

    def steer(self, trajectory: TimedTrajectory) -> None:
        """Continue along `trajectory`, which at its present time is where the previous one is."""
        self._trajectory = trajectory

    def go_on(self) -> None:
        """Continue the motion after a stop."""
        self._stopping_since = self._rest_since = None

    def follow(self, now: float, dt: float, progress: Progress, measured: Measured | None, pace: float = 1.0) -> bool:
        """Whether the robot is seen to follow; while its joints are not reported, the strategy holds it for up to
        `hold_timeout`.

        Raises ExecutionFailed if it does not follow: `tolerance_violated` or `driver_stalled`.

        The allowed duration counts time at path speed 1, so slowing down or holding by the executor does not count
        against the robot. At the `pace` (0..1) that the robot's own controls allow, time passes as much slower; at 0 it stands still,
        for at most `paused_timeout`. A driver slower than commanded is still on the path: the allowed duration is that at
        `SLOWEST_PACE`, and `progress_timeout` bounds how long it may stand still.
        """
        if not progress.at_rest:
            self._rest_since = None
        if measured is None or now - measured.time > self._execution.joint_state_timeout:
            self._wait_for_joints(now, dt, measured)
            return False
        self._received_at = now
        self._on_path(measured, progress)
        if self._paused(dt, progress, pace):
            self._reached_at = None
        else:
            self._advancing(now, progress)
        self._commanded += 0.0 if progress.at_rest else dt * progress.speed * pace
        execution = self._execution
        allowed = (
            execution.allowed_duration_factor * self._trajectory.duration / SLOWEST_PACE
            + execution.allowed_duration_margin
        )
        if not progress.finished and self._commanded > allowed:
            raise ExecutionFailed(
                f"the robot is at {progress.time:.2f} s of a motion of {self._trajectory.duration:.2f} s after "
                f"{self._commanded:.2f} s, more than allowed; check its driver",
                code="driver_stalled",
            )
        return True

    def _wait_for_joints(self, now: float, dt: float, measured: Measured | None) -> None:
        if self._received_at is None or dt > CATCH_UP:  # messages from a pause of the executor are still unread
            self._received_at = now
        if now - self._received_at > self._execution.hold_timeout:
            age = np.inf if measured is None else now - measured.time
            raise ExecutionFailed(
                f"the robot has reported no new joints for {age:.2f} s (joint_state_timeout "
                f"{self._execution.joint_state_timeout:g} s, hold_timeout {self._execution.hold_timeout:g} s); check its "
                "driver",
                code="driver_stalled",
            )
        self._rest_since = self._reached_at = None

    def _paused(self, dt: float, progress: Progress, pace: float) -> bool:
        """Whether the robot's own controls hold it. Raises ExecutionFailed once they have for `paused_timeout`."""
        if pace > 0.0 or progress.at_rest:
            self._paused_for = 0.0
            return False
        self._paused_for += dt
        if self._paused_for > self._execution.paused_timeout:
            raise ExecutionFailed(
                f"the robot has been paused by its own controls for {self._paused_for:.0f} s (paused_timeout "
                f"{self._execution.paused_timeout:g} s); release it, then send the motion again",
                code="driver_stalled",
            )
        return True

    def _advancing(self, now: float, progress: Progress) -> None:
        if self._reached_at is None or progress.at_rest or progress.time > self._reached:
            self._reached, self._reached_at = progress.time, now
        elif now - self._reached_at > self._execution.progress_timeout:
            raise ExecutionFailed(
                f"the robot has been at {progress.time:.2f} s of a motion of {self._trajectory.duration:.2f} s for "
                f"{now - self._reached_at:.2f} s (progress_timeout {self._execution.progress_timeout:g} s); check its "
                "driver",
                code="driver_stalled",
            )

    def at_goal(self, now: float, progress: Progress, measured: Measured | None) -> bool:
        """Whether the robot rests at the end of the path, which has been commanded.

        Raises ExecutionFailed (`tolerance_violated`) if it still moves after `settle_time`.
        """
        if measured is None or not progress.finished:
            return False
        if self._stopped(measured) and np.all(self._beside_goal(measured) <= self._execution.goal_tolerance):
            return True
        if self._overdue(now) and not self._stopped(measured):
            self._refuse_to_move(measured)
        return False

    def missed(self, now: float, progress: Progress, measured: Measured | None) -> Problem | None:
        """The error with which the robot rests beside the end of the path after `settle_time`; None if it does not.

        This is not a fault: the robot is at rest, and the next motion starts from its position.
        """
        if measured is None or not progress.finished or not self._stopped(measured) or not self._overdue(now):
            return None
        error = self._beside_goal(measured)
        worst = int(error.argmax())
        return Problem(
            code="tolerance_violated",
            message=f"{self._joints[worst]} missed the end of the motion by {error[worst]:.4f} rad (goal_tolerance "
            f"{self._execution.goal_tolerance:g}) and rests there; find out what blocks or pushes the robot, then plan again from "
            "where it is",
            joint=self._joints[worst],
        )

    def at_rest(self, now: float, progress: Progress, measured: Measured | None) -> bool:
        """Whether the robot stands still after being told to stop; asked at every tick from then on.

        Raises ExecutionFailed if it does not report within `settle_time` after the command has come to rest. Raises
        NotStopped if it does not stand then, or at the latest that long after the longest braking; also if it stands
        further than `path_tolerance` from where it was to stop, because then it has not received the stop.
        """
        if self._stopping_since is None:
            self._stopping_since = now
        if progress.at_rest:
            fresh = measured is not None and now - measured.time <= self._execution.joint_state_timeout
            if measured is not None and fresh and self._stopped(measured):
                self._on_path(measured, progress, NotStopped)
                return True
            if self._overdue(now):
                if measured is None or not fresh:
                    raise ExecutionFailed(
                        "the robot was told to stop and no longer reports its joints; watch the robot, use the emergency stop if "
                        "it moves, and find out why its driver is silent",
                        code="driver_stalled",
                    )
                self._refuse_to_move(measured)
        if now - self._stopping_since > self._stopping:
            raise NotStopped(
                f"the robot could not be stopped: it was told to {now - self._stopping_since:.1f} s ago and is still being "
                "moved; use the emergency stop, see what moves it",
                code="driver_stalled",
            )
        return False

    def rests(self, now: float, progress: Progress, measured: Measured | None) -> bool:
        """Whether the robot stands as commanded, judged by fresh joint states."""
        fresh = measured is not None and now - measured.time <= self._execution.joint_state_timeout
        return measured is not None and fresh and progress.at_rest and self._stopped(measured)

    def _stopped(self, measured: Measured) -> bool:
        return bool(np.all(np.abs(measured.velocity) <= self._execution.stopped_velocity))

    def _overdue(self, now: float) -> bool:
        if self._rest_since is None:
            self._rest_since = now
        return now - self._rest_since > self._execution.settle_time

    def _beside_goal(self, measured: Measured) -> Array:
        return np.abs(measured.position - self._trajectory.end)

    def _on_path(
        self, measured: Measured, progress: Progress, failure: type[ExecutionFailed] = ExecutionFailed
    ) -> None:
        error, tolerance = np.abs(measured.position - progress.command), self._execution.path_tolerance
        worst = int(error.argmax())
        if not error[worst] <= tolerance:
            raise failure(
                f"{self._joints[worst]} left the commanded path by {error[worst]:.4f} rad (path_tolerance {tolerance:g}); "
                "find out what blocks or pushes the robot",
                code="tolerance_violated",
                joint=self._joints[worst],
            )

    def _refuse_to_move(self, measured: Measured) -> None:
        worst = int(np.abs(measured.velocity).argmax())
        raise NotStopped(
            f"{self._joints[worst]} still moves at {abs(measured.velocity[worst]):.3g} rad/s "
            f"{self._execution.settle_time:g} s after the robot was commanded to rest; use the emergency stop "
            "if it goes on, see what moves it",
            code="tolerance_violated",
            joint=self._joints[worst],
        )
