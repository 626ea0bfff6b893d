"""Where the robot was: its measured joints at the moment of an image."""

from __future__ import annotations

import threading
from bisect import bisect_left
from collections import deque

import numpy as np

from zarm_contract.messages import JointState
from zarm_runtime import clock
from zarm_trajectory.arrays import Array

_KEPT = 2000
"""Joint states that are kept: some seconds."""
_MAX_STAMP_LEAD = 1.0
"""A joint state that is stamped later (s) than this from now is not of this robot's clock."""
_GAP = 0.1
"""Longest time (s) between two joint states of a robot that moves: in between, a joint that accelerates by 10 rad/s² is at most 0.7 deg off."""
_REST_TOLERANCE = 0.01
"""A robot whose joints differ by less than this (rad, m) stands."""


class JointHistory:
    """The measured joints of the last seconds, in the order of `joints`. Thread-safe."""

    def __init__(self, joints: tuple[str, ...]) -> None:
        self._joints = joints
        self._lock = threading.Lock()
        self._states: deque[tuple[float, Array]] = deque(maxlen=_KEPT)
        self._newer = threading.Condition(self._lock)

    def receive(self, _key: str, state: JointState) -> None:
        """Take what the robot has measured."""
        if not {*self._joints} <= {*state.joint_names} or state.stamp > clock.unix_time() + _MAX_STAMP_LEAD:
            return
        order = [state.joint_names.index(name) for name in self._joints]
        with self._lock:
            if not self._states or state.stamp > self._states[-1][0]:
                self._states.append((state.stamp, np.array(state.position)[order]))
                self._newer.notify_all()

    def at(self, stamp: float, patience: float = 0.0) -> Array | None:
        """The joints (dof,) at `stamp` (Unix time, s), interpolated; waits up to `patience` s for news of that moment. None if what was measured before and
        after it does not say where the robot was.
        """
        with self._lock:
            self._newer.wait_for(lambda: self._states and self._states[-1][0] >= stamp, clock.real_seconds(patience))
            states = list(self._states)
        after = bisect_left(states, stamp, key=lambda state: state[0])
        if after == len(states):
            return None
        (then, end) = states[after]
        if then == stamp:
            return end
        if after == 0:
            return None
        (before, start) = states[after - 1]
        if then - before > _GAP and np.abs(end - start).max() > _REST_TOLERANCE:
            return None
        return np.asarray(start + (stamp - before) / (then - before) * (end - start))
