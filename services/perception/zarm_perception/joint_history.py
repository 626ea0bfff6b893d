"""Where the robot was: its measured joints at the moment of an image."""

from __future__ import annotations

import threading
import time
from bisect import bisect_left
from collections import deque

import numpy as np
from numpy.typing import NDArray

from zarm_contract.messages import JointState

Array = NDArray[np.float64]

_KEPT = 2000
"""Joint states that are kept: some seconds."""
_AHEAD = 1.0
"""A joint state that is stamped later (s) than this from now is not of this robot's clock."""
_GAP = 0.15
"""Longest time (s) between a moment and the nearest joint state."""


class JointHistory:
    """The measured joints of the last seconds, in the order of `joints`. Thread-safe."""

    def __init__(self, joints: tuple[str, ...]) -> None:
        self._joints = joints
        self._lock = threading.Lock()
        self._states: deque[tuple[float, Array]] = deque(maxlen=_KEPT)
        self._newer = threading.Condition(self._lock)

    def receive(self, _key: str, state: JointState) -> None:
        """Take what the robot has measured."""
        if not {*self._joints} <= {*state.joint_names} or state.stamp > time.time() + _AHEAD:
            return
        order = [state.joint_names.index(name) for name in self._joints]
        with self._lock:
            if not self._states or state.stamp > self._states[-1][0]:
                self._states.append((state.stamp, np.array(state.position)[order]))
                self._newer.notify_all()

    def at(self, stamp: float, patience: float = 0.0) -> Array | None:
        """The joints (dof,) at `stamp` (Unix time, s), interpolated; waits up to `patience` s for news of that moment. None if nothing was measured near
        that moment.
        """
        with self._lock:
            self._newer.wait_for(lambda: self._states and self._states[-1][0] >= stamp, patience)
            states = list(self._states)
        if not states:
            return None
        after = bisect_left(states, stamp, key=lambda state: state[0])
        if after == len(states):
            return states[-1][1] if stamp - states[-1][0] <= _GAP else None
        if after == 0:
            return states[0][1] if states[0][0] - stamp <= _GAP else None
        (before, start), (then, end) = states[after - 1], states[after]
        if min(stamp - before, then - stamp) > _GAP:
            return None
        return np.asarray(start + (stamp - before) / (then - before) * (end - start))
