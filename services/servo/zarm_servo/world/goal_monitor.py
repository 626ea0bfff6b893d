"""The goal that the executor follows: its trajectory, and how far the robot has come on it."""

from __future__ import annotations

import logging
import threading
from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from zarm_contract.errors import ZarmError
from zarm_contract.messages import ExecutorState, GoalState, GoalTrajectory, JointState
from zarm_runtime.bus import Latest
from zarm_servo.kernels.nearest import nearest_time
from zarm_trajectory.trajectory import TimedTrajectory

log = logging.getLogger(__name__)

_STARTED = 2.0
"""A goal whose trajectory arrived this long (s) ago is running by now, or was refused."""
_BEHIND = 0.3
"""The robot may lag the last command by at most this (s of path time)."""
_STATE_AGE = 0.05
"""Greatest age (s) of a goal state when it arrives."""


@dataclass(frozen=True)
class FollowedGoal:
    """The trajectory of a goal, first known at `since` (s, monotonic). At `reported` (s, monotonic) the executor commanded
    the path time `commanded` (s).
    """

    message: GoalTrajectory
    trajectory: TimedTrajectory
    since: float
    commanded: float
    reported: float


class GoalMonitor:
    """Follows the current goal for these joints from the executor's messages. `now` is in s, monotonic. Thread-safe."""

    def __init__(self, joints: tuple[str, ...], measured: Latest[JointState]) -> None:
        self._joints, self._measured = joints, measured
        self._lock = threading.Lock()
        self._followed: FollowedGoal | None = None
        self._ended: deque[str] = deque(maxlen=32)
        self._running: str | None = None

    def on_trajectory(self, message: GoalTrajectory, now: float) -> None:
        """A goal begins, or its trajectory changes."""
        try:
            trajectory = TimedTrajectory.of(message.trajectory, self._joints).begun_at(message.start)
        except ZarmError as error:
            log.warning("a goal cannot be guarded goal_id=%s reason=%s", message.goal_id, error)
            return
        with self._lock:
            before = self._followed
            if message.goal_id in self._ended:
                return
            if before is not None and before.message.goal_id == message.goal_id:
                self._followed = replace(before, message=message, trajectory=trajectory)
            else:
                self._followed = FollowedGoal(message, trajectory, since=now, commanded=message.start, reported=now)

    def on_goal(self, goal: GoalState, now: float) -> bool:
        """Take a goal's progress or result; returns whether the followed goal has ended."""
        with self._lock:
            if goal.done:
                self._ended.append(goal.goal_id)
            followed = self._followed
            if followed is None or followed.message.goal_id != goal.goal_id:
                return False
            self._followed = (
                None if goal.done else replace(followed, commanded=goal.progress * goal.duration, reported=now)
            )
            return goal.done

    def on_state(self, state: ExecutorState) -> None:
        """Note which goal runs."""
        self._running = state.goal_id

    @property
    def newest(self) -> FollowedGoal | None:
        """The last goal announced, unless it has ended."""
        return self._followed

    def current(self, now: float) -> FollowedGoal | None:
        """The goal that is running or about to start."""
        with self._lock:
            followed = self._followed
            if followed is not None and self._running != followed.message.goal_id and now - followed.since > _STARTED:
                self._followed = None
            return self._followed

    def reached(self, followed: FollowedGoal, now: float) -> float:
        """The path time (s) that the robot has reached, or slightly less."""
        trajectory, measured = followed.trajectory, self._measured.get(max_age=_BEHIND)
        first = max(followed.commanded - _BEHIND, float(trajectory.time[0]))
        last = min(followed.commanded + now - followed.reported + _STATE_AGE, trajectory.duration)
        if measured is None or set(measured.joint_names) != set(self._joints):
            return first
        order = [measured.joint_names.index(name) for name in self._joints]
        times, coefficients = np.ascontiguousarray(trajectory.time), np.ascontiguousarray(trajectory.coefficients)
        return nearest_time(times, coefficients, np.array(measured.position)[order], first, max(first, last))
